"""indexes of the records that need a look, so that complete text entries are passed by without being read

The indexes before them stay for older code: dropping them is a later migration's.

Revision ID: 20261129_needs_look
Revises: 20261129_photograph_facts
Create Date: 2026-11-29 10:50:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261129_needs_look"
down_revision = "20261129_photograph_facts"
branch_labels = None
depends_on = None

INDEXES = {
    "ix_effective_record_look_queue": ("study_id", "reviewed", "status", "doubt", "item_id"),
    "ix_effective_record_look_meals": ("study_id", "captured_at", "meal_id", "local_date"),
}
NEEDS_LOOK = "status <> 'rejected' AND reviewed IS {no} AND (origin <> 'declared' OR status = 'needs_review')"


def upgrade() -> None:
    for name, columns in INDEXES.items():
        op.create_index(
            name,
            "effective_record",
            list(columns),
            sqlite_where=sa.text(NEEDS_LOOK.format(no=0)),
            postgresql_where=sa.text(NEEDS_LOOK.format(no="false")),
        )


def downgrade() -> None:
    for name in INDEXES:
        op.drop_index(name, "effective_record")
