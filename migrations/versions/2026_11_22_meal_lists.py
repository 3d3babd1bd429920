"""pages of meals by any filter, out of millions

As with 20261122_record_indexes, an index that is there already is kept, and who runs a large PostgreSQL makes them
beforehand (docs/queries.md). It builds only; nothing is dropped.

Revision ID: 20261122_meal_lists
Revises: 20261122_day_sums
Create Date: 2026-11-22 06:50:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_meal_lists"
down_revision = "20261122_day_sums"
branch_labels = None
depends_on = None

# name, table, columns, condition on SQLite, condition on PostgreSQL
INDEXES: tuple[tuple[str, str, tuple[str, ...], str | None, str | None], ...] = (
    ("ix_meal_list_of_status", "meal",
     ("study_id", "status", "origin", "captured_at", "id", "local_date"), None, None),
    ("ix_meal_list_of_participant", "meal", ("participant_id", "captured_at", "id", "local_date"), None, None),
    ("ix_meal_list_of_failure", "meal", ("study_id", "failure_code", "captured_at", "id", "local_date"),
     "failure_code IS NOT NULL", "failure_code IS NOT NULL"),
    ("ix_meal_list_of_after", "meal", ("study_id", "after_status", "captured_at", "id", "local_date"),
     "after_status IS NOT NULL", "after_status IS NOT NULL"),
    ("ix_meal_client_id", "meal", ("client_id",), None, None),
    ("ix_effective_record_meals_of_food", "effective_record",
     ("food_id", "study_id", "captured_at", "meal_id", "local_date"),
     "status <> 'rejected'", "status <> 'rejected'"),
    ("ix_effective_record_meals_of_flags", "effective_record",
     ("study_id", "flags", "captured_at", "meal_id", "local_date"),
     "status <> 'rejected' AND flags <> '[]'", "status <> 'rejected' AND flags <> '[]'"),
    ("ix_effective_record_meals_to_review", "effective_record",
     ("study_id", "captured_at", "meal_id", "local_date"),
     "status <> 'rejected' AND reviewed IS 0", "status <> 'rejected' AND reviewed IS false"),
    ("ix_meal_event_questions", "meal_event", ("meal_id",), "kind = 'question'", "kind = 'question'"),
)  # fmt: skip


def upgrade() -> None:
    for name, table, columns, on_sqlite, on_postgresql in INDEXES:
        if op.get_bind().dialect.name == "postgresql":
            drop_unfinished(name)
        op.create_index(
            name,
            table,
            list(columns),
            if_not_exists=True,
            sqlite_where=sa.text(on_sqlite) if on_sqlite is not None else None,
            postgresql_where=sa.text(on_postgresql) if on_postgresql is not None else None,
        )


def downgrade() -> None:
    for name, table, _, _, _ in reversed(INDEXES):
        op.drop_index(name, table_name=table)


def drop_unfinished(name: str) -> None:
    """An index whose CREATE INDEX CONCURRENTLY was broken off has its name, and serves no query."""
    unfinished = sa.text("SELECT 1 FROM pg_index WHERE indexrelid = to_regclass(:name) AND NOT indisvalid")
    if op.get_bind().execute(unfinished, {"name": name}).first() is not None:
        op.drop_index(name)
