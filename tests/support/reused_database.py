"""A PostgreSQL database that one test after another uses: brought back to its template, or dropped if that cannot be.

Copying the prepared template takes some half a second of a test; emptying what a test wrote takes a hundredth. Tables
that the template has rows in (foods, components) are only compared: by their row counts and row versions (xmin, which a
copy keeps and every insert and update changes). Whatever differs there or in the catalogue, or is anybody still
connected, and the database is not used again.
"""

import contextlib
import time
from collections.abc import Iterator

import sqlalchemy as sa

TABLES = """
    SELECT format('%I.%I', schemaname, tablename) FROM pg_tables
    WHERE schemaname NOT IN ('pg_catalog', 'information_schema') ORDER BY 1
"""
CATALOGUE = """
    SELECT count(*), max(c.oid::bigint), max(c.xmin::text::bigint), (SELECT count(*) FROM pg_namespace),
        (SELECT count(*) FROM pg_proc), (SELECT count(*) FROM pg_trigger), (SELECT count(*) FROM pg_constraint)
    FROM pg_class c JOIN pg_namespace n ON n.oid = c.relnamespace
    WHERE n.nspname NOT IN ('pg_catalog', 'information_schema', 'pg_toast') AND n.nspname NOT LIKE 'pg_temp%'
"""
SEQUENCES = """
    SELECT format('%I.%I', schemaname, sequencename), last_value, start_value FROM pg_sequences ORDER BY 1
"""
OTHERS = """
    SELECT count(*) FROM pg_stat_activity
    WHERE datname = current_database() AND pid <> pg_backend_pid() AND backend_type = 'client backend'
"""
LEAVE_SECONDS = 0.5  # a connection that was closed is told so a moment later


class ReusedDatabases:
    """make: a context manager that gives the URL of a fresh copy of the template, and drops it at its end."""

    def __init__(self, make):
        self._make = make
        self._open: dict[str, contextlib.ExitStack] = {}
        self._free: list[str] = []
        self._as_made = None

    @contextlib.contextmanager
    def one(self) -> Iterator[str]:
        """The URL of a database as the template is."""
        url = self._free.pop() if self._free else self._new()
        try:
            yield url
        finally:
            if self._brought_back(url):
                self._free.append(url)
            else:
                self._open.pop(url).close()

    def close(self):
        for stack in self._open.values():
            stack.close()

    def _new(self):
        stack = contextlib.ExitStack()
        url = stack.enter_context(self._make())
        self._open[url] = stack
        if self._as_made is None:
            with connected(url) as connection:
                self._as_made = _AsMade(connection)
        return url

    def _brought_back(self, url):
        with connected(url) as connection:
            return is_alone(connection) and self._as_made.bring_back(connection)


class _AsMade:
    """What a copy is like before a test: which tables have rows, and which versions of them."""

    def __init__(self, connection):
        tables = list(connection.scalars(sa.text(TABLES)))
        self._kept = [table for table in tables if has_rows(connection, table)]
        self._emptied = [table for table in tables if table not in self._kept]
        self._versions = self._versions_of(connection)
        self._catalogue = connection.execute(sa.text(CATALOGUE)).one()
        self._sequences = connection.execute(sa.text(SEQUENCES)).all()

    def bring_back(self, connection) -> bool:
        """Whether the database is now as it was made."""
        if connection.execute(sa.text(CATALOGUE)).one() != self._catalogue:
            return False
        if self._versions_of(connection) != self._versions:
            return False
        empty = " ".join(f"DELETE FROM {table};" for table in self._emptied)
        start = " ".join(
            f"PERFORM setval('{name}', {start if last is None else last}, {'false' if last is None else 'true'});"
            for name, last, start in self._sequences
        )
        connection.execute(sa.text("SET session_replication_role = replica"))  # neither triggers nor references
        connection.execute(sa.text(f"DO $$ BEGIN {empty} {start} END $$"))
        return True

    def _versions_of(self, connection):
        parts = [
            f"SELECT '{table}', count(*), max(xmin::text::bigint), sum(xmin::text::bigint) FROM {table}"
            for table in self._kept
        ]
        return connection.execute(sa.text(" UNION ALL ".join(parts))).all()


def is_alone(connection):
    deadline = time.monotonic() + LEAVE_SECONDS
    while connection.scalar(sa.text(OTHERS)):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def has_rows(connection, table):
    return connection.execute(sa.text(f"SELECT EXISTS (SELECT 1 FROM {table})")).scalar()


@contextlib.contextmanager
def connected(url):
    engine = sa.create_engine(url, isolation_level="AUTOCOMMIT", poolclass=sa.NullPool)
    try:
        with engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()
