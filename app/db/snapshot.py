"""All rows of our tables as they stood at one moment, streamed, while others go on writing.

SQLite: a read transaction over the write-ahead log, which grows until it ends. PostgreSQL: REPEATABLE READ, the tables
locked against migrations (ACCESS SHARE) before the first look, as pg_dump does.
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
    """One moment of a database. Made by `snapshot_of`."""

    def __init__(self, connection: sa.Connection) -> None:
        self._connection = connection

    def rows(self, table: TableLayout) -> Iterator[Sequence[object]]:
        """All rows of a table, in no order, each a value for every column of the layout."""
        query = sa.select(table.table()).execution_options(yield_per=ROWS_AT_A_TIME)
        with self._connection.execute(query) as result:
            yield from result


@contextmanager
def snapshot_of(database: Database, revision: str, layout: Sequence[TableLayout]) -> Iterator[Snapshot]:
    """The moment of this call. Raises UnavailableError where a migration has come in between."""
    with database.read() as session:
        connection = session.connection()
        if not database.is_sqlite:
            # the whole of it may take minutes, and whoever reads it slowly must not lose it
            for setting in ("statement_timeout", "idle_in_transaction_session_timeout"):
                connection.exec_driver_sql(f"SET LOCAL {setting} = 0")
            quote = connection.dialect.identifier_preparer.quote
            tables = ", ".join(quote(table.name) for table in layout)
            connection.exec_driver_sql(f"LOCK TABLE {tables} IN ACCESS SHARE MODE")
        if MigrationContext.configure(connection).get_current_revision() != revision:
            raise UnavailableError("The schema was changed just now: do the same again.")
        differs = difference(connection, layout)
        if differs is not None:
            raise UnavailableError(f"The database is not as its revision {revision} makes it: {differs}.")
        yield Snapshot(connection)
