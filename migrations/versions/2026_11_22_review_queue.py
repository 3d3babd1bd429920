"""pages of the review queue by any filter, out of millions

As with 20261122_record_indexes, an index that is there already is kept, and who runs a large PostgreSQL makes them
beforehand (docs/queries.md).

The queue's former index stays, though the new one serves what it served: servers of the release before look by it while
machines are upgraded one by one. A later release drops it in a migration of its own that builds nothing: building
keeps writers waiting until the commit, dropping waits for whoever has read the table, and of these some come to write.

Revision ID: 20261122_review_queue
Revises: 20261122_spent_keys
Create Date: 2026-11-22 04:10:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_review_queue"
down_revision = "20261122_spent_keys"
branch_labels = None
depends_on = None

INDEXES = (
    (
        "ix_effective_record_study_id_reviewed_status_doubt_item_id",
        ("study_id", "reviewed", "status", "doubt", "item_id"),
        False,
    ),
    (
        "ix_effective_record_queue_of_food",
        ("food_id", "study_id", "reviewed", "status", "doubt", "item_id"),
        False,
    ),
    ("ix_effective_record_queue_of_provisional", ("study_id", "reviewed", "doubt", "item_id"), True),
)


def upgrade() -> None:
    for name, columns, is_of_provisional in INDEXES:
        if op.get_bind().dialect.name == "postgresql":
            drop_unfinished(name)
        op.create_index(
            name,
            "effective_record",
            list(columns),
            if_not_exists=True,
            sqlite_where=sa.text("provisional IS 1") if is_of_provisional else None,
            postgresql_where=sa.text("provisional IS true") if is_of_provisional else None,
        )


def downgrade() -> None:
    for name, _, _ in reversed(INDEXES):
        op.drop_index(name, table_name="effective_record")


def drop_unfinished(name: str) -> None:
    """An index whose CREATE INDEX CONCURRENTLY was broken off has its name, and serves no query."""
    unfinished = sa.text("SELECT 1 FROM pg_index WHERE indexrelid = to_regclass(:name) AND NOT indisvalid")
    if op.get_bind().execute(unfinished, {"name": name}).first() is not None:
        op.drop_index(name)
