"""items may be decided by two reviewers who do not see each other, some with a known answer

Revision ID: 20261130_double
Revises: 20261130_packaged
Create Date: 2026-11-30 12:00:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261130_double"
down_revision = "20261130_packaged"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")
TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    op.add_column("study", sa.Column("double_review", JSON, nullable=True))
    op.create_table(
        "review_decision",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=True),
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("is_final", sa.Boolean(), nullable=False),
        sa.Column("food_key", sa.String(100), nullable=True),
        sa.Column("mass_g", sa.Double(), nullable=True),
        sa.Column("energy_kcal", sa.Double(), nullable=True),
        sa.Column("decided_at", TIME, nullable=False),
        sa.Column("undone_at", TIME, nullable=True),
        sa.Column("settled_at", TIME, nullable=True),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name="fk_review_decision_study_id_study"
        ),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name="fk_review_decision_meal_id_meal"),
        sa.ForeignKeyConstraint(
            ["staff_id"], ["staff.id"], name="fk_review_decision_staff_id_staff"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_review_decision"),
    )
    op.create_index("ix_review_decision_meal_id", "review_decision", ["meal_id"])
    op.create_index(
        "ix_review_decision_study_id_staff_id", "review_decision", ["study_id", "staff_id"]
    )
    op.create_index(
        "ix_review_decision_item_id_staff_id",
        "review_decision",
        ["item_id", "staff_id"],
        unique=True,
        sqlite_where=sa.text("undone_at IS NULL"),
        postgresql_where=sa.text("undone_at IS NULL"),
    )
    op.create_table(
        "known_item",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("food_key", sa.String(100), nullable=False),
        sa.Column("mass_g", sa.Double(), nullable=False),
        sa.Column("shown_g", sa.Double(), nullable=False),
        sa.Column("rings", JSON, nullable=False),
        sa.Column("picture", sa.LargeBinary(), nullable=False),
        sa.Column("width_px", sa.Integer(), nullable=False),
        sa.Column("height_px", sa.Integer(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name="fk_known_item_study_id_study"),
        sa.PrimaryKeyConstraint("id", name="pk_known_item"),
    )
    op.create_index("ix_known_item_study_id", "known_item", ["study_id"])


def downgrade() -> None:
    op.drop_table("known_item")
    op.drop_table("review_decision")
    op.drop_column("study", "double_review")
