"""A table as two files: Parquet, written from rows, and CSV, written from that Parquet file.

Rows are put together anew to batches of one size, so that the same rows give the same bytes, whoever brings them in
which portions. Read back, a Parquet file gives the rows as they were: so rows can be taken out of it later.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, islice
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import parquet

from app.http.tables.columns import Batch, Column, ColumnType, Part, PartOfBatch, Row, instant_text, rows_of
from app.http.tables.csv_rows import encode_csv
from app.http.tables.parquet_rows import encode_parquet

ROWS_A_BATCH = 8192  # a row group is four of them
NUMBERS = frozenset({"number", "integer"})


def rows_of_batches(batches: Iterable[Batch]) -> Iterator[Row]:
    """The rows, each a value for every column."""
    for batch in batches:
        for parts in zip(*(part.as_tuples() for part in batch), strict=True):
            yield tuple(value for part in parts for value in part)


def parquet_pieces(columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[bytes]:
    """The Parquet file of these rows."""
    return encode_parquet(_parts(columns), _batches(columns, rows))


def csv_pieces(columns: Sequence[Column], path: Path) -> Iterator[bytes]:
    """The CSV file of a Parquet file of these columns."""
    return encode_csv(_parts(columns), _batches(columns, read_rows(columns, path)))


def read_rows(columns: Sequence[Column], path: Path) -> Iterator[Row]:
    """The rows of a Parquet file of these columns."""
    with parquet.ParquetFile(path) as file:
        for batch in file.iter_batches(ROWS_A_BATCH, columns=[column.name for column in columns]):
            values = [_plain(column.type, array) for column, array in zip(columns, batch.columns, strict=True)]
            yield from zip(*values, strict=True)


def count_rows(path: Path) -> int:
    """How many rows a Parquet file has, as its footer tells."""
    with parquet.ParquetFile(path) as file:
        return int(file.metadata.num_rows)


def _parts(columns: Sequence[Column]) -> tuple[Part, ...]:
    """Numbers that stand side by side are written together; each other column keeps what it has written."""
    parts: list[Part] = []
    for is_numbers, some in groupby(columns, key=lambda column: column.type in NUMBERS):
        side_by_side = tuple(some)
        if is_numbers:
            parts.append(Part("numbers", side_by_side))
        else:
            parts += [Part("shared", (column,)) for column in side_by_side]
    return tuple(parts)


def _batches(columns: Sequence[Column], rows: Iterable[Row]) -> Iterator[Batch]:
    parts, left = _parts(columns), iter(rows)
    while some := list(islice(left, ROWS_A_BATCH)):
        batch, place = [], 0
        for part in parts:
            width = len(part.columns)
            own = [row[place : place + width] for row in some]
            batch.append(PartOfBatch(part, rows_of(part, own)))
            place += width
        yield batch


def _plain(column_type: ColumnType, array: pa.Array) -> list[Any]:
    """Values as PartOfBatch has them."""
    values: list[Any] = array.to_pylist()
    match column_type:
        case "instant":
            return [None if value is None else instant_text(value) for value in values]
        case "day" | "local time":
            return [None if value is None else value.isoformat() for value in values]
        case "words":
            return [None if value is None else tuple(value) for value in values]
        case _:
            return values
