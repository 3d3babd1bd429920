"""Engines and transactions, on SQLite and PostgreSQL alike: `database.write()` and `database.read()`.

Only use cases open transactions. SQLite: write-ahead log, full sync, one writer at a time (BEGIN
IMMEDIATE, kept short), readers on connections that cannot write. PostgreSQL: READ COMMITTED writes,
read-only reads. A read is a snapshot over all its queries: otherwise a page of changes could miss
one for good. Errors do not quote the values of statements, since errors are logged and the values
are personal.
"""

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TypeVar

import psycopg
import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import IntegrityError, OperationalError
from sqlalchemy.orm import Session

from app.core.errors import TadaError
from app.core.settings import Settings

BUSY_TIMEOUT_SECONDS = 30.0  # a writer waits this long for another writer on SQLite
POOL_WAIT_SECONDS = 10.0  # for a free connection; then the request fails with 503
# PostgreSQL: connections are replaced after this time, to follow a failover
CONNECTION_LIFE_SECONDS = 1800.0
CONNECT_SECONDS = 10  # PostgreSQL: to connect
# PostgreSQL: a vanished host (no FIN, no RST) is detected within a minute, even during a statement
TCP_LIVENESS = {
    "keepalives_idle": 30,
    "keepalives_interval": 10,
    "keepalives_count": 3,
    "tcp_user_timeout": 60_000,
}
# PostgreSQL: dates as text are ISO (db/statements.py, stored_text). Plan each query for its values
# (a generic plan reads a whole study for one day), and do not compile statements, which takes
# longer than executing them. Join more than four tables in the order written: for a page of records
# PostgreSQL would compare all orders for 8 ms, then read the page in 3 ms.
PG_SESSION = (
    "-c timezone=UTC -c datestyle=ISO -c plan_cache_mode=force_custom_plan -c jit=off"
    " -c join_collapse_limit=4"
)
PG_DATA_EXCEPTION = "22"  # class of SQLSTATEs: invalid values
PG_DEADLOCK = "40P01"
DEADLOCK_TRIES = 5
PG_DISK_FULL = "53100"  # SQLSTATE disk_full


Result = TypeVar("Result")


@contextmanager
def unless_taken(taken: TadaError) -> Iterator[None]:
    """Wrap a transaction that creates something unique: if it violates a constraint, raise `taken`.

    If two create the same thing concurrently, one succeeds.
    """
    try:
        yield
    except IntegrityError as error:
        raise taken from error


@dataclass(frozen=True, slots=True)
class PoolLimits:
    """Limits of one process: it keeps `size` connections and opens at most `overflow` more for a while."""

    size: int = 10
    overflow: int = 10
    statement_seconds: float = 30.0  # PostgreSQL: maximum time of a statement

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Return the limits in TADA_DATABASE_*."""
        return cls(
            size=settings.database_pool_size,
            overflow=settings.database_pool_overflow,
            statement_seconds=settings.database_statement_seconds,
        )


def open_database(settings: Settings) -> "Database":
    """Open the configured database with the configured limits."""
    return Database(settings.resolved_database_url, PoolLimits.of(settings))


class Database:
    """The engines of one process.

    Create it in a composition root, pass it on, dispose of it at the end.
    """

    def __init__(self, url: str, limits: PoolLimits | None = None) -> None:
        limits = limits or PoolLimits()
        self.limits = limits
        self.url = normalise_url(url)
        self.is_sqlite = self.url.startswith("sqlite")
        self._writing = threading.Lock()
        if self.is_sqlite:
            self.write_engine = _sqlite_engine(
                self.url, limits, begin="BEGIN IMMEDIATE", query_only=False
            )
            self.read_engine = _sqlite_engine(
                self.url, limits, begin="BEGIN DEFERRED", query_only=True
            )
        else:
            self.write_engine = sa.create_engine(
                self.url,
                pool_size=limits.size,
                max_overflow=limits.overflow,
                pool_timeout=POOL_WAIT_SECONDS,
                pool_recycle=CONNECTION_LIFE_SECONDS,
                pool_pre_ping=True,
                hide_parameters=True,
                connect_args={
                    "options": f"{PG_SESSION} -c statement_timeout={int(limits.statement_seconds * 1000)}",
                    "connect_timeout": CONNECT_SECONDS,
                    **TCP_LIVENESS,
                },
            )
            event.listen(self.write_engine, "handle_error", _without_values)
            self.read_engine = self.write_engine.execution_options(
                isolation_level="REPEATABLE READ", postgresql_readonly=True
            )

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Yield a session in one transaction: committed at the end, rolled back on any exception."""
        with (
            self._write_lock(),
            Session(self.write_engine, expire_on_commit=False) as session,
            session.begin(),
        ):
            yield session

    @contextmanager
    def _write_lock(self) -> Iterator[None]:
        """On SQLite, serialise the writing threads of this process, so that each starts as soon as the last one ends.

        SQLite's own wait polls at intervals of up to 0.1 s: eight simultaneous uploads spent nine
        tenths of their time in it. If the lock is not acquired in time, continue without it: SQLite
        then raises "database is locked".
        """
        is_locked = self.is_sqlite and self._writing.acquire(timeout=BUSY_TIMEOUT_SECONDS)
        try:
            yield
        finally:
            if is_locked:
                self._writing.release()

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Yield a session in one read-only transaction: a snapshot from its first query on.

        The database refuses writes in it.
        """
        with Session(self.read_engine, expire_on_commit=False) as session, session.begin():
            yield session

    def empty_log(self, patience_seconds: float = 1.0) -> bool:
        """SQLite: move the write-ahead log into the database and empty it, so that no erased data remain in it.

        Returns False if readers or writers prevented it: try again. PostgreSQL: nothing to do.
        """
        if not self.is_sqlite:
            return True
        connection = self.write_engine.raw_connection()
        try:
            cursor = connection.cursor()
            cursor.execute(f"PRAGMA busy_timeout = {int(patience_seconds * 1000)}")
            busy, *_ = cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            cursor.execute(f"PRAGMA busy_timeout = {int(BUSY_TIMEOUT_SECONDS * 1000)}")
        finally:
            connection.close()
        return not busy

    def dispose(self) -> None:
        """Close all connections."""
        self.read_engine.dispose()
        self.write_engine.dispose()


def normalise_url(url: str) -> str:
    """Return a database URL with `postgresql://` or `postgres://` replaced by psycopg 3's scheme."""
    for prefix in ("postgresql://", "postgres://"):
        if url.startswith(prefix):
            return "postgresql+psycopg://" + url.removeprefix(prefix)
    return url


def sqlite_connection_pragmas(connection: sqlite3.Connection) -> None:
    """Set the pragmas that every SQLite connection needs."""
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")  # an acknowledged meal survives a power cut
    connection.execute("PRAGMA foreign_keys = ON")
    connection.execute(f"PRAGMA busy_timeout = {int(BUSY_TIMEOUT_SECONDS * 1000)}")
    connection.execute("PRAGMA secure_delete = ON")  # overwrites erased data in the file


def _sqlite_engine(url: str, limits: PoolLimits, *, begin: str, query_only: bool) -> sa.Engine:
    path = sa.make_url(url).database
    if path:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    engine = sa.create_engine(
        url,
        pool_size=limits.size,
        max_overflow=limits.overflow,
        pool_timeout=POOL_WAIT_SECONDS,
        hide_parameters=True,
        connect_args={"timeout": BUSY_TIMEOUT_SECONDS},
    )

    @event.listens_for(engine, "connect")
    def prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None  # the driver opens no transactions: `begin` below does
        sqlite_connection_pragmas(connection)
        if query_only:
            connection.execute("PRAGMA query_only = ON")

    @event.listens_for(engine, "begin")
    def begin_transaction(connection: sa.Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _without_values(context: sa.engine.ExceptionContext) -> None:
    """Reduce PostgreSQL's error text to its first line and SQLSTATE: the rest has values ("DETAIL: Key (code)=(...)").

    For a data exception (class 22) keep only the SQLSTATE: the first line quotes the value too.
    """
    original, ours = context.original_exception, context.sqlalchemy_exception
    if not isinstance(original, psycopg.Error) or original.sqlstate is None:
        return
    full_text, reduced = str(original), f"SQLSTATE {original.sqlstate}"
    if not original.sqlstate.startswith(PG_DATA_EXCEPTION):
        reduced = f"{original.diag.message_primary} ({reduced})"
    original.args = (reduced,)
    if ours is not None:
        ours.args = tuple(
            argument.replace(full_text, reduced) if isinstance(argument, str) else argument
            for argument in ours.args
        )


def despite_deadlocks(transaction: Callable[[], Result]) -> Result:
    """Run a whole transaction, and run it again if PostgreSQL aborted it because of a deadlock."""
    for _ in range(DEADLOCK_TRIES - 1):
        try:
            return transaction()
        except OperationalError as error:
            if getattr(error.orig, "sqlstate", None) != PG_DEADLOCK:
                raise
    return transaction()


def is_disk_full(error: Exception) -> bool:
    """Return whether a database error means that its disk is full, by error code."""
    original = getattr(error, "orig", None)
    if isinstance(original, sqlite3.Error):
        return getattr(original, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return getattr(original, "sqlstate", None) == PG_DISK_FULL
