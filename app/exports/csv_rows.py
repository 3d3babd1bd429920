"""Batches as CSV (RFC 4180), safe to open in a spreadsheet."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from app.exports.cells import Words, number_texts
from app.exports.record_columns import Batch, Column

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")  # a spreadsheet would compute such a cell
LINE_END = "\r\n"


def encode_csv(columns: Sequence[Column], batches: Iterable[Batch]) -> Iterator[bytes]:
    """The header, then each batch's rows. Lists of words stand in one cell, a blank between; None is an empty cell."""
    words = Words(_cell)
    yield (",".join(column.name for column in columns) + LINE_END).encode()
    for batch in batches:
        cells = [_cells(column, values, words) for column, values in zip(columns, batch, strict=True)]
        yield "".join(",".join(row) + LINE_END for row in zip(*cells, strict=True)).encode()


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula gets an apostrophe before it; a list stands in one cell."""
    if isinstance(value, list):
        value = " ".join(str(part) for part in value)
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_STARTS) else value


def _cells(column: Column, values: list[Any], words: Words) -> list[str]:
    match column.type:
        case "number" | "integer":
            return ["" if text == "null" else text for text in number_texts(values)]
        case "boolean":
            return ["True" if value else "False" for value in values]
        case "words":
            return words([" ".join(value) for value in values])
        case "word":
            return words(values)
        case "id" | "instant" | "day":  # nothing in them that CSV would quote
            return values


def _cell(text: str | None) -> str:
    buffer = io.StringIO()
    # a second column, since a row of one empty cell would be quoted to show that it is there
    csv.writer(buffer, lineterminator="").writerow([safe_cell(text), ""])
    return buffer.getvalue()[:-1]
