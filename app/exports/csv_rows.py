"""Batches as CSV (RFC 4180), safe to open in a spreadsheet."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from app.exports.record_columns import Batch, Column

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute such a cell
TEXTS = frozenset({"text", "word"})


def encode_csv(columns: Sequence[Column], batches: Iterable[Batch]) -> Iterator[bytes]:
    """The header, then each batch's rows. Lists of words stand in one cell, a blank between."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(column.name for column in columns)
    yield buffer.getvalue().encode()
    for batch in batches:
        buffer.seek(0)
        buffer.truncate()
        cells = [_cells(column, values) for column, values in zip(columns, batch, strict=True)]
        writer.writerows(zip(*cells, strict=True))
        yield buffer.getvalue().encode()


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula gets an apostrophe before it; a list stands in one cell."""
    if isinstance(value, list):
        value = " ".join(str(part) for part in value)
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_STARTS) else value


def _cells(column: Column, values: list[Any]) -> list[Any]:
    if column.type == "words":
        return [safe_cell(value) for value in values]
    if column.type in TEXTS:
        return [f"'{value}" if value is not None and value.startswith(FORMULA_STARTS) else value for value in values]
    return values
