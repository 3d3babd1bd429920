"""Batches as Parquet: typed columns, units in the fields' metadata, row groups written as they fill.

Imported only where Parquet is asked for: pyarrow is 60 MB of a process's memory.
"""

import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pyarrow as pa
from pyarrow import parquet

from app.http.tables.columns import Batch, Cell, Column, ColumnType, Part, PartOfBatch

ROWS_A_GROUP = 32_768  # some 10 MB in memory, and large enough to be read in few pieces
TYPES: dict[ColumnType, pa.DataType] = {
    "id": pa.string(),
    "word": pa.string(),
    "instant": pa.timestamp("us", tz="UTC"),
    "local time": pa.timestamp("us"),
    "day": pa.date32(),
    "number": pa.float64(),
    "integer": pa.int64(),
    "boolean": pa.bool_(),
    "words": pa.list_(pa.string()),
}


class _Pieces(io.RawIOBase):
    """What the writer wrote since it was last taken."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        piece = bytes(data)
        self._pieces.append(piece)
        return len(piece)

    def take(self) -> bytes:
        taken = b"".join(self._pieces)
        self._pieces.clear()
        return taken


def encode_parquet(parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """The file in pieces, a row group at a time; the pieces are not a file until the last one."""
    columns = [column for part in parts for column in part.columns]
    schema, pieces = schema_of(columns), _Pieces()
    words = [column.name for column in columns if column.type == "word"]
    with parquet.ParquetWriter(pieces, schema, compression="zstd", use_dictionary=words) as writer:
        tables: list[pa.RecordBatch] = []
        for batch in batches:
            arrays = [array for part in batch for array in _arrays(part.deduplicated())]
            tables.append(pa.RecordBatch.from_arrays(arrays, schema=schema))
            if sum(table.num_rows for table in tables) >= ROWS_A_GROUP:
                writer.write_table(pa.Table.from_batches(tables, schema), row_group_size=ROWS_A_GROUP)
                tables.clear()
                yield pieces.take()
        if tables:
            writer.write_table(pa.Table.from_batches(tables, schema), row_group_size=ROWS_A_GROUP)
    yield pieces.take()


def schema_of(columns: Sequence[Column]) -> pa.Schema:
    """The columns' types; metadata "unit" where the values have one."""
    return pa.schema(
        pa.field(column.name, TYPES[column.type], metadata={"unit": column.unit} if column.unit is not None else None)
        for column in columns
    )


def _arrays(part_of_batch: PartOfBatch) -> list[pa.Array]:
    """A part's columns; rows that come again and again are converted once."""
    arrays = [
        _array(column, values)
        for column, values in zip(part_of_batch.part.columns, part_of_batch.columns(), strict=True)
    ]
    if part_of_batch.places is None:
        return arrays
    places = pa.array(part_of_batch.places, pa.int32())
    return [array.take(places) for array in arrays]


def _array(column: Column, values: Sequence[Cell]) -> pa.Array:
    if column.type in {"instant", "local time", "day"}:
        return pa.array(values, pa.string()).cast(TYPES[column.type])
    return pa.array(values, TYPES[column.type])
