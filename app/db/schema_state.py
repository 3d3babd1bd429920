"""How the database's schema stands to the one that this code was written for: `schema_state`, `current_revision`.

Apart from migrate.py, which changes the schema: processes that serve ask this at each probe of their readiness, and
need not load Alembic for it (10 MB), which would read the same two things, the migrations' heads and one row.

The migrations lie in migrations/ of the checkout and inside the wheel as app/_migrations.
"""

import enum
import re
from functools import cache
from pathlib import Path

import sqlalchemy as sa

from app.core.errors import UnavailableError
from app.db.session import Database

VERSION_TABLE = "alembic_version"
DAY_DIGITS = 8  # a revision's id begins with its day: 20261124_baseline
IDENTIFIER = re.compile(r'^(revision|down_revision) = (?:"(\w+)"|None)$', re.MULTILINE)


class SchemaState(enum.Enum):
    """How the database's schema stands to the one that this code was written for."""

    OLDER = "older"
    CURRENT = "current"
    NEWER = "newer"


class MigrationBusyError(UnavailableError):
    """Another process migrates, or on SQLite writes, and did not end in time; nothing was changed."""

    code = "migration_busy"


def migrations_folder() -> Path:
    """The folder of migrations: in the wheel, else in the checkout."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "_migrations"
    return installed if installed.is_dir() else package.parent / "migrations"


def schema_state(database: Database) -> SchemaState:
    """A revision that this code does not know is a newer one, unless it is of before version 0.4."""
    revision = current_revision(database)
    if revision == head_revision():
        return SchemaState.CURRENT
    is_older = revision is None or revision in revisions() or is_before_baseline(revision)
    return SchemaState.OLDER if is_older else SchemaState.NEWER


def is_before_baseline(revision: str) -> bool:
    """Whether a revision is of versions 0.1 to 0.3, which no migration leads on from."""
    day, baseline_day = revision[:DAY_DIGITS], revisions()[0][:DAY_DIGITS]
    return day.isdecimal() and day < baseline_day


def is_current(database: Database) -> bool:
    """Whether the schema is the very one that this code was written for."""
    return schema_state(database) is SchemaState.CURRENT


def current_revision(database: Database) -> str | None:
    """The schema's revision; None where there is none yet."""
    with database.read_engine.connect() as connection:
        return revision_of(connection)


def revision_of(connection: sa.Connection) -> str | None:
    """The same, of a connection in the midst of a transaction."""
    if not sa.inspect(connection).has_table(VERSION_TABLE):
        return None
    found: str | None = connection.scalar(sa.text(f"SELECT version_num FROM {VERSION_TABLE}"))  # noqa: S608  # ours
    return found


def head_revision() -> str:
    """The revision that this code was written for."""
    return revisions()[-1]


@cache
def revisions() -> tuple[str, ...]:
    """All that this code knows, the first one first. They are one line, without branches."""
    after = {}
    for path in (migrations_folder() / "versions").glob("*.py"):
        names = dict(IDENTIFIER.findall(path.read_text(encoding="utf-8")))
        after[names["down_revision"]] = names["revision"]
    ordered, last = [], ""
    while last in after:
        last = after[last]
        ordered.append(last)
    return tuple(ordered)
