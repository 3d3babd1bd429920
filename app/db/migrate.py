"""Brings the schema up to date with Alembic, or back: `upgrade`, `downgrade`. How it stands: schema_state.py.

One migrator at a time, in one transaction, which holds the lock too: whatever ends the migrator, or its connection,
ends both, and the schema is as it was. Nothing is waited for without end. Code beside a newer schema is the rule while
machines are upgraded one by one (docs/deployment.md): such code goes on, and migrates nothing.
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
LOOK_SECONDS = 0.2  # how often a migrator that waits for its turn asks for it
PG_LOCK_NOT_AVAILABLE = "55P03"  # SQLSTATE of a lock_timeout that ran out
PG_DEADLOCK = "40P01"
PG_INVALID_PARAMETER_VALUE = "22023"
PG_CHECKS_CLIENTS = 140_000  # the first PostgreSQL that notices during a long statement that its client has died


@dataclass(frozen=True, slots=True)
class Patience:
    """What a migrator waits for at most, in seconds; another one in tests."""

    turn_seconds: float = 120.0  # while another migrator works; on SQLite while anybody writes
    lock_seconds: float = 5.0  # PostgreSQL: for one table; everybody who comes later waits behind it for so long
    tries: int = 8  # to get the tables' locks; in between the others go on
    pause_seconds: float = 2.0
    statement_seconds: float = 3600.0  # PostgreSQL: an index on the largest table
    idle_seconds: float = 300.0  # PostgreSQL: a migrator that does nothing for so long has been stopped


class MigrationBlockedError(UnavailableError):
    """A table was in use without pause: its lock was never free; nothing was changed."""

    code = "migration_blocked"


class SchemaUnknownError(ConflictError):
    """The schema was made by a newer program, which alone can change it, or by one before 0.4."""

    code = "schema_unknown"


def upgrade(database: Database, revision: str = "head", patience: Patience | None = None) -> None:
    """Migrate up to `revision`. Does nothing if a newer program has migrated further than this one knows.

    Raises MigrationBusyError or MigrationBlockedError when patience ends, InvalidInputError for no such revision,
    SchemaUnknownError when `revision` is told and the schema is a newer program's. Nothing is changed then.
    """
    if revision == "head":
        state = schema_state(database)
        if state is not SchemaState.OLDER:
            if state is SchemaState.NEWER:
                log.info("schema_is_newer", revision=current_revision(database), known=head_revision())
            return
    _migrate(database, command.upgrade, revision, patience or Patience())


def downgrade(database: Database, revision: str, patience: Patience | None = None) -> None:
    """Migrate down to `revision`; what the older schema cannot hold is lost, as its migration says. Raises: upgrade."""
    _migrate(database, command.downgrade, revision, patience or Patience())


def _migrate(database: Database, run: Callable[[Config, str], None], revision: str, patience: Patience) -> None:
    if revision not in {"head", "base", *revisions()}:
        raise InvalidInputError(f"There is no revision {revision!r}. Those that there are: {', '.join(revisions())}.")
    turn = _sqlite_turn if database.is_sqlite else _postgres_turn
    deadline = time.monotonic() + patience.turn_seconds
    for attempt in range(1, patience.tries + 1):
        try:
            with turn(database, patience, deadline) as connection:
                before = revision_of(connection)
                if before is not None and before not in revisions():
                    _require_newer(before)
                    if revision == "head":  # a newer program was quicker
                        return
                    raise SchemaUnknownError(
                        f"The schema ({before}) was made by a newer program than this one, which only that knows to "
                        "change."
                    )
                run(_config(connection), revision)
                if database.is_sqlite and revision_of(connection) != before:
                    _require_whole_references(connection)
        except sa.exc.OperationalError as error:
            if getattr(error.orig, "sqlstate", None) not in (PG_LOCK_NOT_AVAILABLE, PG_DEADLOCK):
                raise
            log.warning("migration_waits_for_a_table", attempt=attempt, of=patience.tries)
            if attempt == patience.tries:
                raise MigrationBlockedError(
                    f"A table that has to change was in use at each of {patience.tries} tries, so nothing was changed. "
                    "Look in pg_stat_activity for transactions that stay open (a backup, an export, somebody's psql), "
                    "then migrate again."
                ) from error
        else:
            return
        time.sleep(patience.pause_seconds)


def _require_newer(revision: str) -> None:
    if is_before_baseline(revision):
        raise SchemaUnknownError(
            f"The schema ({revision}) was made by a version before 0.4, whose databases are not brought up to date: "
            "start with an empty one."
        )


@contextmanager
def _postgres_turn(database: Database, patience: Patience, deadline: float) -> Iterator[sa.Connection]:
    """A connection in the one transaction that may migrate; committed at the end. The lock is the transaction's own."""
    with database.write_engine.connect() as connection:
        while True:
            with connection.begin():
                if connection.scalar(sa.text("SELECT pg_try_advisory_xact_lock(:n)"), {"n": ADVISORY_LOCK}):
                    _limit(connection, patience)
                    yield connection
                    return
            if time.monotonic() > deadline:
                raise _busy("Another process migrates", patience)
            time.sleep(LOOK_SECONDS)


def _limit(connection: sa.Connection, patience: Patience) -> None:
    limits = {
        "lock_timeout": patience.lock_seconds,
        "statement_timeout": patience.statement_seconds,
        "idle_in_transaction_session_timeout": patience.idle_seconds,
    }
    for name, seconds in limits.items():
        connection.execute(sa.text(f"SET LOCAL {name} = {int(seconds * 1000)}"))
    if int(connection.scalar(sa.text("SHOW server_version_num"))) >= PG_CHECKS_CLIENTS:
        _notice_our_death(connection, patience.lock_seconds)


def _notice_our_death(connection: sa.Connection, every_seconds: float) -> None:
    """Have PostgreSQL look during long statements whether we still live.

    Where its system cannot tell (on Windows and, before 15, all but Linux) it refuses the setting: then our locks last
    until the statement ends, as before 14.
    """
    try:
        with connection.begin_nested():
            connection.execute(sa.text(f"SET LOCAL client_connection_check_interval = {int(every_seconds * 1000)}"))
    except sa.exc.DBAPIError as error:
        if getattr(error.orig, "sqlstate", None) != PG_INVALID_PARAMETER_VALUE:
            raise
        log.info("client_connection_not_checked", reason=" ".join(str(error.orig).split()))


@contextmanager
def _sqlite_turn(database: Database, patience: Patience, _deadline: float) -> Iterator[sa.Connection]:
    """The same on SQLite, where BEGIN IMMEDIATE is the lock."""
    with database.write_engine.connect() as connection:
        # It alters a table by making it anew, and dropping the old one would count as deleting its rows. Only outside a
        # transaction can this be set.
        _set_pragma(connection, "foreign_keys = OFF")
        _set_pragma(connection, f"busy_timeout = {int(patience.turn_seconds * 1000)}")
        try:
            try:
                transaction = connection.begin()
            except sa.exc.OperationalError as error:
                if getattr(error.orig, "sqlite_errorcode", None) != sqlite3.SQLITE_BUSY:
                    raise
                raise _busy("Another process writes to the database", patience) from error
            with transaction:
                yield connection
        finally:
            _set_pragma(connection, f"busy_timeout = {int(BUSY_TIMEOUT_SECONDS * 1000)}")
            _set_pragma(connection, "foreign_keys = ON")


def _busy(what: str, patience: Patience) -> MigrationBusyError:
    return MigrationBusyError(
        f"{what}, for more than {patience.turn_seconds:.0f} s: wait for it to end, then do the same again."
    )


def _set_pragma(connection: sa.Connection, setting: str) -> None:
    """On the driver's own connection: SQLAlchemy's would begin a transaction."""
    cursor = connection.connection.cursor()
    cursor.execute(f"PRAGMA {setting}")
    cursor.close()


def _require_whole_references(connection: sa.Connection) -> None:
    """Raises sa.exc.IntegrityError, before the commit, if a migration left a reference to a row that is not there."""
    broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
    if broken:
        raise sa.exc.IntegrityError("PRAGMA foreign_key_check", None, ValueError(f"rows refer to none: {broken[:5]}"))


def _config(connection: sa.Connection) -> Config:
    config = Config()
    config.set_main_option("script_location", str(migrations_folder()))
    config.attributes["connection"] = connection
    return config
