"""Compare the database's schema with the one that this code was written for: `schema_state`, `current_revision`.

Separate from migrate.py, since servers call this at each readiness probe and need not load Alembic
(10 MB) for it. The migrations are in migrations/ of the checkout, and in the wheel as
app/_migrations.
"""

import enum
import re
from functools import cache
from pathlib import Path

import sqlalchemy as sa

from app.core.errors import UnavailableError
from app.core.shipped import shipped_folder
from app.db.session import Database

VERSION_TABLE = "alembic_version"
DAY_DIGITS = 8  # a revision's id begins with its date: 20261124_baseline
IDENTIFIER = re.compile(r'^(revision|down_revision) = (?:"(\w+)"|None)$', re.MULTILINE)


class SchemaState(enum.Enum):
    """The database's schema compared with the one that this code was written for."""

    OLDER = "older"
    CURRENT = "current"
    NEWER = "newer"


class MigrationBusyError(UnavailableError):
    """Another process is migrating, or on SQLite writing, and did not end in time; nothing was changed."""

    code = "migration_busy"


def migrations_folder() -> Path:
    """Return the folder of migrations: of the wheel, or of the checkout."""
    return shipped_folder("_migrations", "migrations")


def schema_state(database: Database) -> SchemaState:
    """Return the schema's state; an unknown revision is newer, unless it is from before version 0.4."""
    revision = current_revision(database)
    if revision == head_revision():
        return SchemaState.CURRENT
    is_older = revision is None or revision in revisions() or is_before_baseline(revision)
    return SchemaState.OLDER if is_older else SchemaState.NEWER


def is_before_baseline(revision: str) -> bool:
    """Return whether a revision is of versions 0.1 to 0.3, which cannot be migrated."""
    day, baseline_day = revision[:DAY_DIGITS], revisions()[0][:DAY_DIGITS]
    return day.isdecimal() and day < baseline_day


def is_current(database: Database) -> bool:
    """Return whether the schema is the one that this code was written for."""
    return schema_state(database) is SchemaState.CURRENT


def current_revision(database: Database) -> str | None:
    """Return the schema's revision; None if there is none yet."""
    with database.read_engine.connect() as connection:
        return revision_of(connection)


def revision_of(connection: sa.Connection) -> str | None:
    """Return the same, read on a connection within its transaction."""
    if not sa.inspect(connection).has_table(VERSION_TABLE):
        return None
    revision: str | None = connection.scalar(sa.text(f"SELECT version_num FROM {VERSION_TABLE}"))  # noqa: S608  # ours
    return revision


def head_revision() -> str:
    """Return the revision that this code was written for."""
    return revisions()[-1]


@cache
def revisions() -> tuple[str, ...]:
    """Return all known revisions, the first one first; they have no branches."""
    after = {}
    for path in (migrations_folder() / "versions").glob("*.py"):
        names = dict(IDENTIFIER.findall(path.read_text(encoding="utf-8")))
        after[names["down_revision"]] = names["revision"]
    ordered, last = [], ""
    while last in after:
        last = after[last]
        ordered.append(last)
    return tuple(ordered)
