"""Engines and transactions, on SQLite and PostgreSQL alike: `database.write()` and `database.read()`.

Only services open transactions. SQLite: write-ahead log, full sync, one writer at a time (BEGIN IMMEDIATE, kept short),
readers on connections that cannot write. PostgreSQL: READ COMMITTED writes, read-only reads. A read sees one
moment, however many queries it makes: else a page of changes may pass one over for good. Errors do not quote the values
of their statements: they end up in logs, and the values are about people.
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
POOL_WAIT_SECONDS = 10.0  # for a free connection; then the request is told to come back (503)
CONNECTION_LIFE_SECONDS = 1800.0  # PostgreSQL: then a connection is made anew, so that a failover is followed
CONNECT_SECONDS = 10  # PostgreSQL: to a host that does not answer
# PostgreSQL: a host that vanished (no FIN, no RST) is noticed within a minute, also in the middle of a statement
TCP_LIVENESS = {"keepalives_idle": 30, "keepalives_interval": 10, "keepalives_count": 3, "tcp_user_timeout": 60_000}
# PostgreSQL: plans made for the values of each question (one for any day or filter reads a whole study where a day was
# asked for), and no compiling of statements, which takes longer than they do
PG_SESSION = "-c timezone=UTC -c plan_cache_mode=force_custom_plan -c jit=off"
PG_DATA_EXCEPTION = "22"  # class of SQLSTATEs: a value that cannot be
PG_DEADLOCK = "40P01"
DEADLOCK_TRIES = 5
PG_DISK_FULL = "53100"  # SQLSTATE disk_full


Result = TypeVar("Result")


@contextmanager
def unless_taken(taken: TadaError) -> Iterator[None]:
    """Around a transaction that makes something of which there may be one: a constraint that it breaks raises `taken`.

    Of two that make the same at the same time one succeeds.
    """
    try:
        yield
    except IntegrityError as error:
        raise taken from error


@dataclass(frozen=True, slots=True)
class PoolLimits:
    """What one process takes of a database server at most: `size` connections are kept, `overflow` more for a while."""

    size: int = 10
    overflow: int = 10
    statement_seconds: float = 30.0  # PostgreSQL: no request may hold a connection longer

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """As TADA_DATABASE_* say."""
        return cls(
            size=settings.database_pool_size,
            overflow=settings.database_pool_overflow,
            statement_seconds=settings.database_statement_seconds,
        )


def open_database(settings: Settings) -> "Database":
    """The database that the settings name, within the limits that they set."""
    return Database(settings.resolved_database_url, PoolLimits.of(settings))


class Database:
    """The engines of one process. Make one in a composition root, pass it on, dispose of it at the end."""

    def __init__(self, url: str, limits: PoolLimits | None = None) -> None:
        limits = limits or PoolLimits()
        self.limits = limits
        self.url = normalise_url(url)
        self.is_sqlite = self.url.startswith("sqlite")
        self._writing = threading.Lock()
        if self.is_sqlite:
            self.write_engine = _sqlite_engine(self.url, limits, begin="BEGIN IMMEDIATE", query_only=False)
            self.read_engine = _sqlite_engine(self.url, limits, begin="BEGIN DEFERRED", query_only=True)
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
        """A session in one transaction: committed at the end, rolled back on any exception."""
        with self._turn_to_write(), Session(self.write_engine, expire_on_commit=False) as session, session.begin():
            yield session

    @contextmanager
    def _turn_to_write(self) -> Iterator[None]:
        """SQLite: this process's threads write one after the other, each at once when the one before is done.

        Left to SQLite they would sleep and look again, up to 0.1 s at a time: eight uploads at once spent nine tenths
        of their time so. Who has no turn in time goes on and is told by SQLite who is in the way.
        """
        has_turn = self.is_sqlite and self._writing.acquire(timeout=BUSY_TIMEOUT_SECONDS)
        try:
            yield
        finally:
            if has_turn:
                self._writing.release()

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A session in one read-only transaction: a snapshot from its first query on.

        A write in it is an error of the database.
        """
        with Session(self.read_engine, expire_on_commit=False) as session, session.begin():
            yield session

    def empty_log(self, patience_seconds: float = 1.0) -> bool:
        """SQLite: move the write-ahead log into the database and empty it, so that nothing erased is left in it.

        Whether that is done; False: somebody reads or writes without pause, try again. PostgreSQL: nothing to do.
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
    """`postgresql://` (and `postgres://`) mean psycopg 3 here."""
    for prefix in ("postgresql://", "postgres://"):
        if url.startswith(prefix):
            return "postgresql+psycopg://" + url.removeprefix(prefix)
    return url


def sqlite_connection_pragmas(connection: sqlite3.Connection) -> None:
    """What every SQLite connection has."""
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")  # an acknowledged meal survives a power cut
    connection.execute("PRAGMA foreign_keys = ON")
    connection.execute(f"PRAGMA busy_timeout = {int(BUSY_TIMEOUT_SECONDS * 1000)}")
    connection.execute("PRAGMA secure_delete = ON")  # erased is erased, in the file too


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
        connection.isolation_level = None  # the driver begins nothing by itself: `begin` below does
        sqlite_connection_pragmas(connection)
        if query_only:
            connection.execute("PRAGMA query_only = ON")

    @event.listens_for(engine, "begin")
    def begin_transaction(connection: sa.Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _without_values(context: sa.engine.ExceptionContext) -> None:
    """PostgreSQL tells the values that it refused ("DETAIL: Key (code)=(...)"): leave its first line and the SQLSTATE.

    Of a data exception (class 22) the first line itself quotes the value.
    """
    original, ours = context.original_exception, context.sqlalchemy_exception
    if not isinstance(original, psycopg.Error) or original.sqlstate is None:
        return
    told, kept = str(original), f"SQLSTATE {original.sqlstate}"
    if not original.sqlstate.startswith(PG_DATA_EXCEPTION):
        kept = f"{original.diag.message_primary} ({kept})"
    original.args = (kept,)
    if ours is not None:
        ours.args = tuple(one.replace(told, kept) if isinstance(one, str) else one for one in ours.args)


def despite_deadlocks(transaction: Callable[[], Result]) -> Result:
    """Do a whole transaction, and the same again where PostgreSQL ended it so that another could go on."""
    for _ in range(DEADLOCK_TRIES - 1):
        try:
            return transaction()
        except OperationalError as error:
            if getattr(error.orig, "sqlstate", None) != PG_DEADLOCK:
                raise
    return transaction()


def is_disk_full(error: Exception) -> bool:
    """Whether a database error says that its disk is full, by code, not by words."""
    original = getattr(error, "orig", None)
    if isinstance(original, sqlite3.Error):
        return getattr(original, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return getattr(original, "sqlstate", None) == PG_DISK_FULL
