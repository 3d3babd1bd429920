"""an owner may teach a study a food by photographs; their vectors are kept

Revision ID: 20261130_taught
Revises: 20261130_context
Create Date: 2026-11-30 08:00:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261130_taught"
down_revision = "20261130_context"
branch_labels = None
depends_on = None

STUDY_FOOD = ("study_id", "food_key", "sha256")


def upgrade() -> None:
    op.create_table(
        "taught_photograph",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("food_key", sa.String(100), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("vcm_version", sa.String(16), nullable=False),
        sa.Column("vector", sa.LargeBinary(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("in_force_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name="fk_taught_photograph_study_id_study"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_taught_photograph"),
    )
    op.create_index(
        "ix_taught_photograph_study_id_food_key_sha256",
        "taught_photograph",
        STUDY_FOOD,
        unique=True,
    )


def downgrade() -> None:
    op.drop_table("taught_photograph")
