"""pages of records by any filter, and of days, out of millions

An index that is there already is kept: who runs a large PostgreSQL makes them beforehand, while meals come in, by
CREATE INDEX CONCURRENTLY (docs/queries.md); in here, in a transaction, making them keeps writers waiting.

Revision ID: 20261122_record_indexes
Revises: 20261122_fair_turns
Create Date: 2026-11-22 00:10:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_record_indexes"
down_revision = "20261122_fair_turns"
branch_labels = None
depends_on = None

INDEXES = (
    ("effective_record", ("study_id", "status", "captured_at", "item_id")),
    ("effective_record", ("food_id", "study_id", "status", "captured_at", "item_id")),
    ("meal", ("study_id", "local_date", "participant_id")),
)


def upgrade() -> None:
    for table, columns in INDEXES:
        name = f"ix_{table}_{'_'.join(columns)}"
        if op.get_bind().dialect.name == "postgresql":
            drop_unfinished(name)
        op.create_index(op.f(name), table, list(columns), if_not_exists=True)


def downgrade() -> None:
    for table, columns in reversed(INDEXES):
        op.drop_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table_name=table)


def drop_unfinished(name: str) -> None:
    """An index whose CREATE INDEX CONCURRENTLY was broken off has its name, and serves no query."""
    unfinished = sa.text("SELECT 1 FROM pg_index WHERE indexrelid = to_regclass(:name) AND NOT indisvalid")
    if op.get_bind().execute(unfinished, {"name": name}).first() is not None:
        op.drop_index(name)
