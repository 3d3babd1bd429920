"""releases: a study's data frozen under a name

Revision ID: 20261122_releases
Revises: 20261122_exports
Create Date: 2026-11-22 07:20:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261122_releases"
down_revision = "20261122_exports"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.create_table(
        "release",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("filters", JSON, nullable=False),
        sa.Column("checksum", sa.String(64)),
        sa.Column("frozen_at", sa.DateTime(timezone=True)),
        sa.Column("altered_at", sa.DateTime(timezone=True)),
        sa.Column("former_checksums", JSON, nullable=False),
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
            "state IN ('queued', 'running', 'ready', 'changing', 'failed')", name=op.f("ck_release_state")
        ),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_release_study_id_study")),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_release_staff_id_staff")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_release")),
        sa.UniqueConstraint("study_id", "name", name=op.f("uq_release_study_id_name")),
    )
    op.create_index(op.f("ix_release_staff_id"), "release", ["staff_id"])
    op.create_index(op.f("ix_release_state_requested_at"), "release", ["state", "requested_at"])
    op.create_index(op.f("ix_release_study_id_requested_at_id"), "release", ["study_id", "requested_at", "id"])
    op.create_table(
        "release_file",
        sa.Column("release_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("rows", sa.BigInteger()),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("blob_key", sa.String(300), nullable=False),
        sa.ForeignKeyConstraint(["release_id"], ["release.id"], name=op.f("fk_release_file_release_id_release")),
        sa.PrimaryKeyConstraint("release_id", "name", name=op.f("pk_release_file")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_release_file_blob_key")),
    )
    op.create_table(
        "release_change",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("release_id", sa.Uuid(), nullable=False),
        sa.Column("deed", sa.String(16), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("new_code", sa.String(64)),
        sa.Column("new_ids", sa.Uuid()),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("deed IN ('meal', 'erase', 'anonymise')", name=op.f("ck_release_change_deed")),
        sa.CheckConstraint(
            "(deed = 'anonymise') = (new_code IS NOT NULL)", name=op.f("ck_release_change_code_of_who_stays")
        ),
        sa.ForeignKeyConstraint(["release_id"], ["release.id"], name=op.f("fk_release_change_release_id_release")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_release_change")),
    )
    op.create_index(op.f("ix_release_change_release_id"), "release_change", ["release_id"])


def downgrade() -> None:
    op.drop_table("release_change")
    op.drop_table("release_file")
    op.drop_table("release")
