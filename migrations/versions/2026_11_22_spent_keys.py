"""keys of orphans are spent: what is deleted is named by no row afterwards

Revision ID: 20261122_spent_keys
Revises: 20261122_last_backup
Create Date: 2026-11-22 03:30:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_spent_keys"
down_revision = "20261122_last_backup"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "spent_key",
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("spent_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_spent_key")),
    )


def downgrade() -> None:
    op.drop_table("spent_key")
