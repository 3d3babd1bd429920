"""pages of records by any filter, out of millions

Revision ID: 20261122_record_indexes
Revises: 20261122_fair_turns
Create Date: 2026-11-22 00:10:00
"""

revision = "20261122_record_indexes"
down_revision = "20261122_fair_turns"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Filled with the issue that measures."""


def downgrade() -> None:
    """Nothing to take back."""
