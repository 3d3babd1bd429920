"""exports that are made in the background

Revision ID: 20261122_exports
Revises: 20261122_meal_lists
Create Date: 2026-11-22 06:50:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261122_exports"
down_revision = "20261122_meal_lists"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")
UNDER_WAY = sa.text("state IN ('queued', 'running')")


def upgrade() -> None:
    op.create_table(
        "export",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("spec", JSON, nullable=False),
        sa.Column("spec_sha256", sa.String(64), nullable=False),
        sa.Column("sha256", sa.String(64)),
        sa.Column("blob_key", sa.String(300)),
        sa.Column("expires_at", sa.DateTime(timezone=True)),
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("claim", sa.Uuid()),
        sa.Column("heartbeat_at", sa.DateTime(timezone=True)),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("begin_after", sa.DateTime(timezone=True)),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True)),
        sa.Column("finished_at", sa.DateTime(timezone=True)),
        sa.Column("rows_written", sa.BigInteger(), nullable=False),
        sa.Column("rows_estimated", sa.BigInteger()),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("at_change_seq", sa.BigInteger()),
        sa.Column("failure_code", sa.String(64)),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'done', 'failed', 'cancelled', 'expired')", name=op.f("ck_export_state")
        ),
        sa.CheckConstraint("(state = 'done') = (blob_key IS NOT NULL)", name=op.f("ck_export_file_of_what_is_done")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_export_study_id_study")),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_export_staff_id_staff")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_export")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_export_blob_key")),
    )
    op.create_index(op.f("ix_export_staff_id"), "export", ["staff_id"])
    op.create_index(op.f("ix_export_state_requested_at"), "export", ["state", "requested_at"])
    op.create_index(op.f("ix_export_study_id_requested_at_id"), "export", ["study_id", "requested_at", "id"])
    op.create_index(
        "uq_export_under_way",
        "export",
        ["study_id", "staff_id", "spec_sha256"],
        unique=True,
        sqlite_where=UNDER_WAY,
        postgresql_where=UNDER_WAY,
    )


def downgrade() -> None:
    op.drop_table("export")
