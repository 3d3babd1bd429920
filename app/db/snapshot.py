"""Stream all rows of our tables as of one moment, while others continue to write.

SQLite: a read transaction over the write-ahead log, which grows until it ends. PostgreSQL: REPEATABLE READ, with the
tables locked against migrations (ACCESS SHARE) before the first query, as pg_dump does.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import sqlalchemy as sa
from alembic.migration import MigrationContext

from app.core.errors import UnavailableError
from app.db.layout import TableLayout, difference
from app.db.session import Database

ROWS_AT_A_TIME = 2_000


class Snapshot:
    """A snapshot of a database. Created by `snapshot_of`."""

    def __init__(self, connection: sa.Connection) -> None:
        self._connection = connection

    def rows(self, table: TableLayout) -> Iterator[Sequence[object]]:
        """Yield all rows of a table, unordered, each with a value for every column of the layout."""
        query = sa.select(table.table()).execution_options(yield_per=ROWS_AT_A_TIME)
        with self._connection.execute(query) as result:
            yield from result


@contextmanager
def snapshot_of(database: Database, revision: str, layout: Sequence[TableLayout]) -> Iterator[Snapshot]:
    """Yield a snapshot as of this call. Raises UnavailableError if the schema has been migrated since."""
    with database.read() as session:
        connection = session.connection()
        if not database.is_sqlite:
            # reading everything may take minutes, and a slow reader must not be cut off
            for setting in ("statement_timeout", "idle_in_transaction_session_timeout"):
                connection.exec_driver_sql(f"SET LOCAL {setting} = 0")
            quote = connection.dialect.identifier_preparer.quote
            tables = ", ".join(quote(table.name) for table in layout)
            connection.exec_driver_sql(f"LOCK TABLE {tables} IN ACCESS SHARE MODE")
        if MigrationContext.configure(connection).get_current_revision() != revision:
            raise UnavailableError("The schema has just been changed: try again.")
        differs = difference(connection, layout)
        if differs is not None:
            raise UnavailableError(f"The database does not match its revision {revision}: {differs}.")
        yield Snapshot(connection)
