"""Tables as Parquet files: which tables there are at a revision, and their rows to files and back.

The types are those of the columns, alike for SQLite and PostgreSQL, so that a value comes back as
it was on either. A value of another type than its column, which SQLite may hold, is an error now
rather than when the backup is needed.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from functools import cache
from pathlib import Path
from typing import Any
from uuid import UUID

import pyarrow as pa
import pyarrow.parquet as pq
import sqlalchemy as sa

from app.core.errors import InvalidInputError
from app.db.base import UtcDateTime
from app.db.migrate import SchemaUnknownError, upgrade
from app.db.schema_state import current_revision, revisions
from app.db.session import Database

ROWS_AT_A_TIME = 2_000
FILE_BYTES = 8 * 1024 * 1024  # of rows in memory; a file ends with the rows that exceed it
# left out: the schema's revision; leases; the key and the clock that were seen; exports, which can
# be requested again
TRANSIENT_TABLES = frozenset(("alembic_version", "worker_lease", "deployment", "export"))


@dataclass(frozen=True, slots=True)
class ColumnKind:
    """How the values of a column are stored.

    sql: type to select and insert by, on either database
    arrow: type in a file
    python: class of every value but NULL
    """

    sql: sa.types.TypeEngine[Any]
    arrow: pa.DataType
    python: type


KINDS = {  # by a column's type in a SQLite database that was created by migrations
    sa.CHAR: ColumnKind(sa.Uuid(), pa.uuid(), UUID),
    sa.String: ColumnKind(sa.Text(), pa.string(), str),
    sa.DateTime: ColumnKind(UtcDateTime(), pa.timestamp("us", "UTC"), datetime),
    sa.Date: ColumnKind(sa.Date(), pa.date32(), date),
    sa.JSON: ColumnKind(sa.types.NullType(), pa.json_(), str),  # the database's text
    sa.LargeBinary: ColumnKind(sa.LargeBinary(), pa.binary(), bytes),
    sa.Boolean: ColumnKind(sa.Boolean(), pa.bool_(), bool),
    sa.Integer: ColumnKind(sa.BigInteger(), pa.int64(), int),
    sa.Float: ColumnKind(sa.Double(), pa.float64(), float),
}


def known_revision(database: Database) -> str | None:
    """Return the schema's revision; None if there are no tables. Raises SchemaUnknownError."""
    revision = current_revision(database)
    if revision is not None and revision not in revisions():
        raise SchemaUnknownError(
            f"The schema ({revision}) is a newer program's: back up and restore with that program.",
        )
    return revision


@cache
def tables_at(revision: str) -> dict[str, sa.Table]:
    """Return our tables at a known revision by name, referenced ones first.

    Read from a scratch database, since the one to be read may not be upgraded yet, and may have
    other tables beside ours.
    """
    with tempfile.TemporaryDirectory(prefix="tada-tables-") as folder:
        scratch = Database(f"sqlite:///{Path(folder) / 'scratch.sqlite3'}")
        try:
            upgrade(scratch, revision)
            metadata = sa.MetaData()
            metadata.reflect(scratch.read_engine)
        finally:
            scratch.dispose()
    for table in metadata.tables.values():
        for column in table.columns:
            kind = _kind_of(column)
            column.type, column.info["kind"] = kind.sql, kind
    tables = {table.name: table for table in metadata.sorted_tables}
    return {name: table for name, table in tables.items() if name not in TRANSIENT_TABLES}


def schema_of(table: sa.Table) -> pa.Schema:
    """Return the schema of a table's files."""
    return pa.schema([(column.name, column.info["kind"].arrow) for column in table.columns])


def write_files(connection: sa.Connection, table: sa.Table) -> Iterator[tuple[int, bytes]]:
    """Yield a table's rows, unordered, as files, each with its number of rows; none if it is empty.

    Raises InvalidInputError (`database_inconsistent`).
    """
    batches: list[pa.RecordBatch] = []
    query = sa.select(*map(_selected, table.columns))
    query = query.execution_options(yield_per=ROWS_AT_A_TIME)
    with connection.execute(query) as result:
        for rows in result.partitions():
            batches.append(_batch(rows, table))
            if sum(batch.nbytes for batch in batches) >= FILE_BYTES:
                yield _file(batches)
                batches.clear()
    if batches:
        yield _file(batches)


def read_file(content: bytes, table: sa.Table) -> Iterator[pa.RecordBatch]:
    """Yield a file's rows, ROWS_AT_A_TIME. Raises ValueError if it is not one of this table."""
    try:
        file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
        if not file.schema_arrow.equals(schema_of(table)):
            raise ValueError(f"its columns are not those of {table.name}")
        yield from file.iter_batches(ROWS_AT_A_TIME)
    except (OSError, pa.ArrowException) as error:  # of bytes in memory, thus of the file
        raise ValueError("it is not Parquet") from error


def _selected(column: sa.Column[Any]) -> sa.ColumnElement[Any]:
    return sa.cast(column, sa.Text) if isinstance(column.type, sa.types.NullType) else column


def _kind_of(column: sa.Column[Any]) -> ColumnKind:
    return next(kind for reflected, kind in KINDS.items() if isinstance(column.type, reflected))


def _batch(rows: Sequence[sa.Row[Any]], table: sa.Table) -> pa.RecordBatch:
    arrays = []
    for column, values in zip(table.columns, zip(*rows, strict=True), strict=True):
        kind = column.info["kind"]
        if not set(map(type, values)) <= {kind.python, type(None)}:
            raise InvalidInputError(
                f"Table {table.name} has a value of another type than its column {column.name}: "
                "it could not be restored.",
                code="database_inconsistent",
            )
        arrays.append(pa.array(values, kind.arrow))
    return pa.record_batch(arrays, schema=schema_of(table))


def _file(batches: list[pa.RecordBatch]) -> tuple[int, bytes]:
    rows = pa.Table.from_batches(batches)
    file = pa.BufferOutputStream()
    pq.write_table(rows, file, compression="zstd", write_page_checksum=True)
    return rows.num_rows, file.getvalue().to_pybytes()
