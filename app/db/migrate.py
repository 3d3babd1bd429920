"""Migrate the schema with Alembic: `upgrade`, `downgrade`; the triggers that keep it.

Only one process migrates at a time, in one transaction that also holds the lock: if the process or
its connection ends, both are gone and the schema is unchanged. Every wait is bounded. Code with a
newer schema is normal while machines are upgraded one by one (docs/deployment.md): it keeps working
and migrates nothing. The current state: schema_state.py.
"""

import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import sqlalchemy as sa
import structlog
from alembic import command
from alembic.config import Config

from app.core.errors import ConflictError, InvalidInputError, UnavailableError
from app.db.schema_state import (
    MigrationBusyError,
    SchemaState,
    current_revision,
    head_revision,
    is_before_baseline,
    migrations_folder,
    revision_of,
    revisions,
    schema_state,
)
from app.db.session import BUSY_TIMEOUT_SECONDS, Database

log = structlog.get_logger()

ADVISORY_LOCK = 7_241_960_311  # one migrator at a time; the number has no meaning
POLL_SECONDS = 0.2  # interval at which a waiting migrator tries the lock
PG_LOCK_NOT_AVAILABLE = "55P03"  # SQLSTATE of an expired lock_timeout
PG_DEADLOCK = "40P01"
PG_INVALID_PARAMETER_VALUE = "22023"
# the first PostgreSQL version that can detect a dead client during a statement
PG_CHECKS_CLIENTS = 140_000
AUDIT = "audit_event"
SQLITE_REFUSE = f"SELECT RAISE(ABORT, '{AUDIT} is append-only');"
SQLITE_TRIGGERS = {
    f"{AUDIT}_no_update": f"BEFORE UPDATE ON {AUDIT}",
    f"{AUDIT}_no_delete": f"BEFORE DELETE ON {AUDIT}",
    # INSERT OR REPLACE fires DELETE triggers only if its connection sets recursive_triggers
    f"{AUDIT}_no_replace": (
        f"BEFORE INSERT ON {AUDIT} WHEN EXISTS (SELECT 1 FROM {AUDIT} WHERE id = NEW.id)"  # noqa: S608  # our own names
    ),
}
POSTGRES_TRIGGER = f"{AUDIT}_no_change"
POSTGRES_EVENT = f"BEFORE UPDATE OR DELETE OR TRUNCATE ON {AUDIT} FOR EACH STATEMENT"
POSTGRES_REFUSE = """
    CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        RAISE EXCEPTION '% is append-only', TG_TABLE_NAME;
    END $$
"""


@dataclass(frozen=True, slots=True)
class Patience:
    """Limits of a migrator's waits, in seconds; tests use others."""

    turn_seconds: float = 120.0  # for another migrator; on SQLite for any writer
    # PostgreSQL: for one table's lock; later statements on it queue behind this wait
    lock_seconds: float = 5.0
    tries: int = 8  # attempts to get the tables' locks; others continue in between
    pause_seconds: float = 2.0
    statement_seconds: float = 3600.0  # PostgreSQL: for an index on the largest table
    idle_seconds: float = 300.0  # PostgreSQL: a migrator idle for this long has been suspended


class MigrationBlockedError(UnavailableError):
    """A table's lock could not be acquired at any attempt; nothing was changed."""

    code = "migration_blocked"


class SchemaUnknownError(ConflictError):
    """The schema was created by a newer program, which alone can change it, or by a version before 0.4."""

    code = "schema_unknown"


def upgrade(database: Database, revision: str = "head", patience: Patience | None = None) -> None:
    """Migrate up to `revision`.

    Does nothing if a newer program has already migrated beyond this one's head.

    Raises MigrationBusyError or MigrationBlockedError after `patience`, InvalidInputError for an
    unknown revision, SchemaUnknownError if `revision` is given and the schema is a newer program's.
    Nothing is changed then.
    """
    if revision == "head":
        state = schema_state(database)
        if state is not SchemaState.OLDER:
            if state is SchemaState.NEWER:
                log.info(
                    "schema_is_newer", revision=current_revision(database), known=head_revision()
                )
            return
    _migrate(database, command.upgrade, revision, patience or Patience())


def downgrade(database: Database, revision: str, patience: Patience | None = None) -> None:
    """Migrate down to `revision`; data that the older schema has no room for are lost.

    Raises as `upgrade` does.
    """
    _migrate(database, command.downgrade, revision, patience or Patience())


def _migrate(
    database: Database, run: Callable[[Config, str], None], revision: str, patience: Patience
) -> None:
    if revision not in {"head", "base", *revisions()}:
        raise InvalidInputError(
            f"There is no revision {revision!r}; the revisions are {', '.join(revisions())}."
        )
    locked = _sqlite_migration_lock if database.is_sqlite else _postgres_migration_lock
    deadline = time.monotonic() + patience.turn_seconds
    for attempt in range(1, patience.tries + 1):
        try:
            with locked(database, patience, deadline) as connection:
                current = revision_of(connection)
                if current is not None and current not in revisions():
                    _require_newer(current)
                    if revision == "head":  # a newer program migrated first
                        return
                    raise SchemaUnknownError(
                        f"The schema ({current}) was created by a newer program, which alone can change it."
                    )
                run(_config(connection), revision)
                if database.is_sqlite and revision_of(connection) != current:
                    _check_foreign_keys(connection)
        except sa.exc.OperationalError as error:
            if getattr(error.orig, "sqlstate", None) not in (PG_LOCK_NOT_AVAILABLE, PG_DEADLOCK):
                raise
            log.warning("migration_waits_for_a_table", attempt=attempt, of=patience.tries)
            if attempt == patience.tries:
                raise MigrationBlockedError(
                    f"A table that has to change was in use at each of {patience.tries} attempts; nothing was changed. "
                    "Look in pg_stat_activity for open transactions (a backup, an export, a psql session), "
                    "then migrate again."
                ) from error
        else:
            return
        time.sleep(patience.pause_seconds)


def _require_newer(revision: str) -> None:
    if is_before_baseline(revision):
        raise SchemaUnknownError(
            f"The schema ({revision}) was created by a version before 0.4, whose databases cannot be upgraded: "
            "start with an empty one."
        )


@contextmanager
def _postgres_migration_lock(
    database: Database, patience: Patience, deadline: float
) -> Iterator[sa.Connection]:
    """Yield a connection in a transaction that holds the migration lock; commit at the end."""
    with database.write_engine.connect() as connection:
        while True:
            with connection.begin():
                if connection.scalar(
                    sa.text("SELECT pg_try_advisory_xact_lock(:n)"), {"n": ADVISORY_LOCK}
                ):
                    _limit(connection, patience)
                    yield connection
                    return
            if time.monotonic() > deadline:
                raise _busy("Another process is migrating", patience)
            time.sleep(POLL_SECONDS)


def _limit(connection: sa.Connection, patience: Patience) -> None:
    limits = {
        "lock_timeout": patience.lock_seconds,
        "statement_timeout": patience.statement_seconds,
        "idle_in_transaction_session_timeout": patience.idle_seconds,
    }
    for name, seconds in limits.items():
        connection.execute(sa.text(f"SET LOCAL {name} = {int(seconds * 1000)}"))
    if int(connection.scalar(sa.text("SHOW server_version_num"))) >= PG_CHECKS_CLIENTS:
        _check_client_connection(connection, patience.lock_seconds)


def _check_client_connection(connection: sa.Connection, every_seconds: float) -> None:
    """Make PostgreSQL check during long statements whether this client is still connected.

    Where its platform does not support this (Windows and, before 15, all but Linux) it refuses the
    setting: our locks then last until the statement ends, as before 14.
    """
    try:
        with connection.begin_nested():
            connection.execute(
                sa.text(f"SET LOCAL client_connection_check_interval = {int(every_seconds * 1000)}")
            )
    except sa.exc.DBAPIError as error:
        if getattr(error.orig, "sqlstate", None) != PG_INVALID_PARAMETER_VALUE:
            raise
        log.info("client_connection_not_checked", reason=" ".join(str(error.orig).split()))


@contextmanager
def _sqlite_migration_lock(
    database: Database, patience: Patience, _deadline: float
) -> Iterator[sa.Connection]:
    """Do the same on SQLite, where BEGIN IMMEDIATE is the lock."""
    with database.write_engine.connect() as connection:
        # SQLite alters a table by recreating it, and dropping the old one would count as deleting
        # its rows. The pragma can only be set outside a transaction.
        _set_pragma(connection, "foreign_keys = OFF")
        _set_pragma(connection, f"busy_timeout = {int(patience.turn_seconds * 1000)}")
        try:
            try:
                transaction = connection.begin()
            except sa.exc.OperationalError as error:
                if getattr(error.orig, "sqlite_errorcode", None) != sqlite3.SQLITE_BUSY:
                    raise
                raise _busy("Another process is writing to the database", patience) from error
            with transaction:
                yield connection
        finally:
            _set_pragma(connection, f"busy_timeout = {int(BUSY_TIMEOUT_SECONDS * 1000)}")
            _set_pragma(connection, "foreign_keys = ON")


def _busy(reason: str, patience: Patience) -> MigrationBusyError:
    return MigrationBusyError(
        f"{reason}, for more than {patience.turn_seconds:.0f} s: wait for it to end, then try again."
    )


def _set_pragma(connection: sa.Connection, setting: str) -> None:
    """Set a pragma on the driver's connection, since SQLAlchemy's would begin a transaction."""
    cursor = connection.connection.cursor()
    cursor.execute(f"PRAGMA {setting}")
    cursor.close()


def _check_foreign_keys(connection: sa.Connection) -> None:
    """Raise sa.exc.IntegrityError, before the commit, if a migration left a dangling reference."""
    broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
    if broken:
        raise sa.exc.IntegrityError(
            "PRAGMA foreign_key_check", None, ValueError(f"dangling references: {broken[:5]}")
        )


def _config(connection: sa.Connection) -> Config:
    config = Config()
    config.set_main_option("script_location", str(migrations_folder()))
    config.attributes["connection"] = connection
    return config


def create_triggers(connection: sa.Connection) -> None:
    """Create all triggers, replacing existing ones."""
    drop_triggers(connection)
    if connection.dialect.name == "sqlite":
        for name, event in SQLITE_TRIGGERS.items():
            connection.exec_driver_sql(f"CREATE TRIGGER {name} {event} BEGIN {SQLITE_REFUSE} END")
        return
    connection.exec_driver_sql(POSTGRES_REFUSE.replace("%", "%%"))
    connection.exec_driver_sql(
        f"CREATE TRIGGER {POSTGRES_TRIGGER} {POSTGRES_EVENT} EXECUTE FUNCTION refuse_change()"
    )


def drop_triggers(connection: sa.Connection) -> None:
    """Drop all triggers; harmless if they or their table do not exist."""
    if AUDIT not in sa.inspect(connection).get_table_names():
        return
    if connection.dialect.name == "sqlite":
        for name in SQLITE_TRIGGERS:
            connection.exec_driver_sql(f"DROP TRIGGER IF EXISTS {name}")
        return
    connection.exec_driver_sql(f"DROP TRIGGER IF EXISTS {POSTGRES_TRIGGER} ON {AUDIT}")
    connection.exec_driver_sql("DROP FUNCTION IF EXISTS refuse_change()")
