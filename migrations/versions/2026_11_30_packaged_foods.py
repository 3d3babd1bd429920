"""packaged foods of Open Food Facts' dump, by barcode

Revision ID: 20261130_packaged
Revises: 20261130_taught
Create Date: 2026-11-30 11:00:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261130_packaged"
down_revision = "20261130_taught"
branch_labels = None
depends_on = None

FIGURES = (
    "pack_g",
    "serving_g",
    "energy_kcal",
    "protein_g",
    "fat_g",
    "saturated_fat_g",
    "carbohydrate_g",
    "available_carbohydrate_g",
    "sugar_g",
    "fibre_g",
    "sodium_mg",
)


def upgrade() -> None:
    op.create_table(
        "packaged_food",
        sa.Column("release_id", sa.Integer(), nullable=False),
        sa.Column("code", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(300), nullable=False),
        sa.Column("brands", sa.String(200), nullable=True),
        sa.Column("is_liquid", sa.Boolean(), nullable=False),
        *(sa.Column(name, sa.Float(), nullable=True) for name in FIGURES),
        sa.ForeignKeyConstraint(
            ["release_id"], ["food_release.id"], name="fk_packaged_food_release_id_food_release"
        ),
        sa.PrimaryKeyConstraint("release_id", "code", name="pk_packaged_food"),
        sqlite_with_rowid=False,
    )


def downgrade() -> None:
    op.drop_table("packaged_food")
