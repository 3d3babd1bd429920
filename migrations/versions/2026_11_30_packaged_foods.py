"""packaged foods of Open Food Facts' dump, by barcode, and participants' favourites

Revision ID: 20261130_packaged
Revises: 20261130_taught
Create Date: 2026-11-30 11:00:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261130_packaged"
down_revision = "20261130_taught"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.create_table(
        "packaged_food",
        sa.Column("release_id", sa.Integer(), nullable=False),
        sa.Column("code", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(300), nullable=False),
        sa.Column("is_liquid", sa.Boolean(), nullable=False),
        sa.Column("pack_g", sa.Double(), nullable=True),
        sa.Column("serving_g", sa.Double(), nullable=True),
        sa.Column("per_100_g", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["release_id"], ["food_release.id"], name="fk_packaged_food_release_id_food_release"
        ),
        sa.PrimaryKeyConstraint("release_id", "code", name="pk_packaged_food"),
        sqlite_with_rowid=False,
    )
    op.add_column("participant", sa.Column("favourites", JSON, nullable=True))


def downgrade() -> None:
    op.drop_column("participant", "favourites")
    op.drop_table("packaged_food")
