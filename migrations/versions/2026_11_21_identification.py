"""what items look like and what the index says of them, confirmed items as the index's entries, colour corrections

New columns keep their server defaults, and rows of the new tables go with their item, so that a process of the version
before can still write, and erase, beside a newer one.

Revision ID: 20261121_identification
Revises: 20261121_people_review
Create Date: 2026-11-21 20:50:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261121_identification"
down_revision = "20261121_people_review"
branch_labels = None
depends_on = None

INSTANT = sa.DateTime(timezone=True)
JSON_VALUE = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.create_table(
        "item_identification",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("vcm_version", sa.String(length=16), nullable=False),
        sa.Column("vector", sa.LargeBinary(), nullable=False),
        sa.Column("index_version", sa.String(length=100), nullable=True),
        sa.Column("none_probability", sa.Double(), nullable=True),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.CheckConstraint(
            "(index_version IS NULL) = (none_probability IS NULL)",
            name=op.f("ck_item_identification_identified_by_an_index"),
        ),
        sa.ForeignKeyConstraint(
            ["item_id"], ["item.id"], name=op.f("fk_item_identification_item_id_item"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_item_identification_run_id_run")),
        sa.PrimaryKeyConstraint("item_id", "run_id", "vcm_version", name=op.f("pk_item_identification")),
    )
    op.create_index(op.f("ix_item_identification_run_id"), "item_identification", ["run_id"])
    op.create_table(
        "index_entry",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("vcm_version", sa.String(length=16), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("food_key", sa.String(length=100), nullable=False),
        sa.Column("volume_ml", sa.Double(), nullable=True),
        sa.Column("captured_at", INSTANT, nullable=False),
        sa.Column("day_minute", sa.Integer(), nullable=False),
        sa.CheckConstraint("day_minute >= 0 AND day_minute < 1440", name=op.f("ck_index_entry_day_minute")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_index_entry_item_id_item"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_index_entry_run_id_run")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_index_entry_study_id_study")),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_index_entry_participant_id_participant")
        ),
        sa.PrimaryKeyConstraint("item_id", name=op.f("pk_index_entry")),
    )
    op.create_index(op.f("ix_index_entry_run_id"), "index_entry", ["run_id"])
    op.create_index(op.f("ix_index_entry_participant_id"), "index_entry", ["participant_id"])
    op.create_index(
        op.f("ix_index_entry_study_id_food_key_captured_at"), "index_entry", ["study_id", "food_key", "captured_at"]
    )
    with op.batch_alter_table("item_candidate") as batch_op:
        batch_op.add_column(sa.Column("run_id", sa.Uuid(), nullable=True))
        batch_op.create_foreign_key(op.f("fk_item_candidate_run_id_run"), "run", ["run_id"], ["id"])
        batch_op.create_index(op.f("ix_item_candidate_run_id"), ["run_id"])
    with op.batch_alter_table("run") as batch_op:
        batch_op.add_column(sa.Column("colour", JSON_VALUE, nullable=True))
    with op.batch_alter_table("study") as batch_op:
        batch_op.add_column(sa.Column("shares_index", sa.Boolean(), nullable=False, server_default=sa.false()))


def downgrade() -> None:
    """What was learned by looks is lost; who said what of which food stays."""
    with op.batch_alter_table("study") as batch_op:
        batch_op.drop_column("shares_index")
    with op.batch_alter_table("run") as batch_op:
        batch_op.drop_column("colour")
    op.execute("DELETE FROM item_candidate WHERE source = 'index'")
    with op.batch_alter_table("item_candidate") as batch_op:
        batch_op.drop_index(op.f("ix_item_candidate_run_id"))
        batch_op.drop_constraint(op.f("fk_item_candidate_run_id_run"), type_="foreignkey")
        batch_op.drop_column("run_id")
    op.drop_table("index_entry")
    op.drop_table("item_identification")
