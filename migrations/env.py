"""Alembic's entry: runs on the connection that app/db/migrate.py hands over, inside its transaction."""

from alembic import context

from app.tables import METADATA

# DBOS keeps its own tables; on SQLite they sit beside ours, and autogenerate must not touch them.
OURS = frozenset(METADATA.tables) | {"alembic_version"}


def include_name(name: str | None, kind: str, parents: object) -> bool:
    del parents
    return kind != "table" or name in OURS


context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=METADATA,
    include_name=include_name,
    compare_type=True,
    render_as_batch=True,
    transaction_per_migration=False,
)
context.run_migrations()
