"""Fill an empty deployment's database with the rows of a backup: all or none.

Indexes and foreign keys are dropped before and recreated after the inserts, in the same transaction: this is several
times faster, and finds dangling references. So are the triggers (triggers.py), which would mark days row by row;
all days are marked at the end, and the workers compute their sums.
"""

import contextlib
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import psycopg
import sqlalchemy as sa
from sqlalchemy.exc import OperationalError, StatementError

from app.core.errors import ConflictError, InvalidInputError
from app.db.layout import TableLayout
from app.db.migrate import downgrade, upgrade
from app.db.schema_state import current_revision
from app.db.session import Database
from app.operations.triggers import MARK_ALL_DAYS, create_triggers, drop_triggers

ROWS_AT_A_TIME = 2_000
STARTER = "starter"  # the food table of every new deployment; a restore replaces it
FOOD_TABLES = frozenset(
    {
        "component", "food", "food_activation", "food_change", "food_code", "food_density", "food_ingredient",
        "food_nutrient", "food_portion", "food_posting", "food_release", "food_word", "food_word_trigram",
    }
)  # fmt: skip
LEAVE_SECONDS = 10.0  # until closed connections are gone, which takes seconds on a busy machine
SQLITE_CACHE_KIB = 64 * 1024  # ids are random, so index pages are written in random order
OTHERS = """
    SELECT count(*) FROM pg_stat_activity
    WHERE datname = current_database() AND pid <> pg_backend_pid() AND usename = current_user
"""
FOREIGN_KEYS = """
    SELECT t.relname, c.conname, pg_get_constraintdef(c.oid) FROM pg_constraint c JOIN pg_class t ON t.oid = c.conrelid
    WHERE c.contype = 'f' AND t.relnamespace = current_schema()::regnamespace AND t.relname = ANY(:tables) ORDER BY 1, 2
"""
INDEXES = """
    SELECT i.relname, pg_get_indexdef(x.indexrelid)
    FROM pg_index x JOIN pg_class i ON i.oid = x.indexrelid JOIN pg_class t ON t.oid = x.indrelid
    WHERE t.relnamespace = current_schema()::regnamespace AND t.relname = ANY(:tables)
        AND NOT EXISTS (SELECT 1 FROM pg_constraint c WHERE c.conindid = x.indexrelid) ORDER BY 1
"""
SEQUENCES = """
    SELECT t.relname, a.attname, pg_get_serial_sequence(quote_ident(t.relname), a.attname)
    FROM pg_class t JOIN pg_attribute a ON a.attrelid = t.oid AND a.attnum > 0 AND NOT a.attisdropped
    WHERE t.relnamespace = current_schema()::regnamespace AND t.relname = ANY(:tables)
        AND pg_get_serial_sequence(quote_ident(t.relname), a.attname) IS NOT NULL
"""


def require_alone(database: Database) -> None:
    """Raise ConflictError (`deployment_in_use`) if another process has this database open."""
    database.dispose()
    if not (_is_alone_on_sqlite(database) if database.is_sqlite else _is_alone_on_postgres(database)):
        raise ConflictError(
            "Another process has the database open: stop servers, workers and other clients connected as the same "
            "user, then try again.",
            code="deployment_in_use",
        )


def require_empty(database: Database, layout: Sequence[TableLayout]) -> None:
    """Raise ConflictError (`deployment_not_empty`) if a table has rows that a new deployment does not have."""
    filled = _filled_table(database, layout, but_starter=True)
    if filled is not None:
        raise ConflictError(
            f"This deployment has data already (table {filled}): restore into an empty one, and move the data over "
            "there or delete it yourself.",
            code="deployment_not_empty",
        )


def make_tables(database: Database, revision: str, layout: Sequence[TableLayout]) -> None:
    """Create the empty tables of a revision, replacing those of an empty deployment."""
    current = current_revision(database)
    if current == revision and _filled_table(database, layout, but_starter=False) is None:
        return
    if current is not None:
        downgrade(database, "base")
    upgrade(database, revision)


class Refill:
    """The transaction of a refill. Created by `refilling`."""

    def __init__(self, connection: sa.Connection) -> None:
        self._connection = connection

    def put(self, table: TableLayout, rows: Iterable[Sequence[object]]) -> int:
        """Insert rows, each with a value for every column of the layout, and return their number.

        Raises InvalidInputError (`backup_refused`) for values that this database refuses.
        """
        with _explain_refusal(table.name):
            if self._connection.dialect.name == "sqlite":
                return self._insert(table, rows)
            return self._copy(table, rows)

    def change(self, statement: sa.Update | sa.Delete) -> int:
        """Change inserted rows, and return the number of rows affected."""
        return self._connection.execute(statement).rowcount

    def _insert(self, table: TableLayout, rows: Iterable[Sequence[object]]) -> int:
        names, count = [column.name for column in table.columns], 0
        statement, remaining = sa.insert(table.table()), iter(rows)
        while batch := [dict(zip(names, row, strict=True)) for row in islice(remaining, ROWS_AT_A_TIME)]:
            self._connection.execute(statement, batch)
            count += len(batch)
        return count

    def _copy(self, table: TableLayout, rows: Iterable[Sequence[object]]) -> int:
        quote, count = self._connection.dialect.identifier_preparer.quote, 0
        names = ", ".join(quote(column.name) for column in table.columns)
        cursor = self._connection.connection.cursor()
        with cursor.copy(f"COPY {quote(table.name)} ({names}) FROM STDIN") as copy:
            for row in rows:
                copy.write_row(row)
                count += 1
        return count


@contextmanager
def refilling(database: Database, layout: Sequence[TableLayout]) -> Iterator[Refill]:
    """Yield a transaction to fill the tables; at its end references are checked and sequences advanced."""
    with database.write() as session:
        connection = session.connection()
        without_indexes = _sqlite_without_indexes if database.is_sqlite else _postgres_without_indexes
        drop_triggers(connection)
        with without_indexes(connection, [table.name for table in layout]):
            yield Refill(connection)
        create_triggers(connection)
        connection.exec_driver_sql(MARK_ALL_DAYS)


@contextmanager
def _sqlite_without_indexes(connection: sa.Connection, tables: Sequence[str]) -> Iterator[None]:
    connection.exec_driver_sql("PRAGMA defer_foreign_keys = ON")  # until commit, since rows refer to later ones
    connection.exec_driver_sql(f"PRAGMA cache_size = -{SQLITE_CACHE_KIB}")
    indexes = connection.execute(
        sa.text("SELECT name, sql FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL AND tbl_name IN :tables")
        .bindparams(sa.bindparam("tables", tables, expanding=True))
    ).all()  # fmt: skip
    quote = connection.dialect.identifier_preparer.quote
    for index in indexes:
        connection.exec_driver_sql(f"DROP INDEX {quote(index.name)}")
    yield
    for index in indexes:
        with _explain_refusal(index.name):
            connection.exec_driver_sql(index.sql)
    broken = connection.exec_driver_sql("PRAGMA foreign_key_check").first()
    if broken is not None:
        raise _refused(broken[0], "a row has a dangling reference")


@contextmanager
def _postgres_without_indexes(connection: sa.Connection, tables: Sequence[str]) -> Iterator[None]:
    for setting in ("statement_timeout", "idle_in_transaction_session_timeout"):
        connection.exec_driver_sql(f"SET LOCAL {setting} = 0")
    quote = connection.dialect.identifier_preparer.quote
    names = {"tables": list(tables)}
    keys = connection.execute(sa.text(FOREIGN_KEYS), names).all()
    indexes = connection.execute(sa.text(INDEXES), names).all()
    for table, name, _ in keys:
        connection.exec_driver_sql(f"ALTER TABLE {quote(table)} DROP CONSTRAINT {quote(name)}")
    for name, _ in indexes:
        connection.exec_driver_sql(f"DROP INDEX {quote(name)}")
    yield
    for name, definition in indexes:
        with _explain_refusal(name):
            connection.exec_driver_sql(definition.replace("%", "%%"))
    for table, name, definition in keys:
        with _explain_refusal(table):
            connection.exec_driver_sql(f"ALTER TABLE {quote(table)} ADD CONSTRAINT {quote(name)} {definition}")
    for table, column, sequence in connection.execute(sa.text(SEQUENCES), names).all():
        query = f"SELECT setval(:name, (SELECT max({quote(column)}) FROM {quote(table)}))"  # noqa: S608  # catalogue's
        connection.execute(sa.text(query), {"name": sequence})
    connection.exec_driver_sql(f"ANALYZE {', '.join(quote(table) for table in tables)}")


@contextmanager
def _explain_refusal(place: str) -> Iterator[None]:
    """Raise `backup_refused` for values that the database refuses, without quoting them; keep operational errors."""
    try:
        yield
    except OperationalError:
        raise
    except psycopg.OperationalError as error:  # of COPY, which bypasses SQLAlchemy
        raise OperationalError("COPY", None, error) from error
    except StatementError as error:
        raise _refused(place, type(error.orig).__name__) from None
    except psycopg.Error as error:
        raise _refused(place, type(error).__name__) from None


def _refused(place: str, reason: str) -> InvalidInputError:
    return InvalidInputError(
        f"The database refuses the backup's rows: {place}: {reason}. None of them was stored.",
        code="backup_refused",
    )


def _is_alone_on_postgres(database: Database) -> bool:
    deadline = time.monotonic() + LEAVE_SECONDS
    with database.read() as session:
        while session.scalar(sa.text(OTHERS)):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
    return True


def _is_alone_on_sqlite(database: Database) -> bool:
    """Return whether no one else has the file open: only then can WAL mode be left; the next connection restores it."""
    path = sa.make_url(database.url).database
    if not path or not Path(path).exists():
        return True
    with contextlib.closing(sqlite3.connect(path, timeout=LEAVE_SECONDS)) as connection:
        try:
            mode = connection.execute("PRAGMA journal_mode = DELETE").fetchone()[0]
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY:
                raise
            return False
    return bool(mode == "delete")


def _filled_table(database: Database, layout: Sequence[TableLayout], *, but_starter: bool) -> str | None:
    """Return the first table with a row. but_starter: ignore the food table of new deployments."""
    with database.read() as session:
        existing = set(sa.inspect(session.connection()).get_table_names())
        for table in layout:
            query = sa.select(sa.literal(1)).select_from(sa.table(table.name)).limit(1)
            if but_starter and table.name == "food_release":
                query = query.where(sa.column("source", sa.Text()) != STARTER)
            elif but_starter and table.name in FOOD_TABLES:
                continue
            if table.name in existing and session.execute(query).first() is not None:
                return table.name
    return None
