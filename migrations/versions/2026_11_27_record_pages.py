"""indexes of record pages with the local day, so that filters of days read no row

The indexes without the day stay for older code: dropping them is a later migration's.

Revision ID: 20261127_record_pages
Revises: 20261127_reminders
Create Date: 2026-11-27 20:10:00
"""

from alembic import op

revision = "20261127_record_pages"
down_revision = "20261127_reminders"
branch_labels = None
depends_on = None

INDEXES = {  # name: columns before (captured_at, item_id, local_date)
    "ix_effective_record_page": (),
    "ix_effective_record_page_of_study": ("study_id",),
    "ix_effective_record_page_of_status": ("study_id", "status"),
    "ix_effective_record_page_of_food": ("food_id", "study_id", "status"),
}


def upgrade() -> None:
    for name, keys in INDEXES.items():
        op.create_index(name, "effective_record", [*keys, "captured_at", "item_id", "local_date"])


def downgrade() -> None:
    for name in INDEXES:
        op.drop_index(name, "effective_record")
