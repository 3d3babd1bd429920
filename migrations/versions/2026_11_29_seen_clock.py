"""the clock that a worker last saw

Revision ID: 20261129_seen_clock
Revises: 20261127_record_pages
Create Date: 2026-11-29 01:40:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261129_seen_clock"
down_revision = "20261127_record_pages"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "seen_clock",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("doubted_seconds", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_seen_clock")),
    )


def downgrade() -> None:
    op.drop_table("seen_clock")
