"""what decoding a photograph costs, and whether it was written anew, so that serving it does not have to find out

Revision ID: 20261129_photograph_facts
Revises: 20261129_put_off_jobs
Create Date: 2026-11-29 09:30:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261129_photograph_facts"
down_revision = "20261129_put_off_jobs"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("meal_image", sa.Column("decoding_pixels", sa.BigInteger, nullable=True))
    op.add_column(
        "meal_image",
        sa.Column("is_reencoded", sa.Boolean, nullable=False, server_default=sa.false()),
    )


def downgrade() -> None:
    op.drop_column("meal_image", "is_reencoded")
    op.drop_column("meal_image", "decoding_pixels")
