"""Batches as CSV (RFC 4180), safe to open in a spreadsheet."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import cast

from pydantic_core import to_json

from app.http.tables.columns import (
    Batch,
    Cell,
    Cells,
    Column,
    ColumnType,
    ConvertedOnce,
    Part,
    PartOfBatch,
    Row,
    as_row,
)

# a spreadsheet would compute such a cell; the last four are full-width, as Chinese and Japanese keyboards type them
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
LINE_END = "\r\n"


def encode_csv(parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """The header, then each batch's rows. Lists of words stand in one cell, a blank between; None is an empty cell."""
    words = ConvertedOnce[Cell, str](_word)
    shared = {part: ConvertedOnce(partial(_cells, part.columns, words)) for part in parts if part.type == "shared"}
    yield (",".join(column.name for part in parts for column in part.columns) + LINE_END).encode()
    for batch in batches:
        texts = (_texts(part, shared) for part in batch)
        yield (LINE_END.join(map(",".join, zip(*texts, strict=True))) + LINE_END).encode()


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula gets an apostrophe before it; a list stands in one cell."""
    if isinstance(value, list | tuple):
        value = " ".join(str(part) for part in value)
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_STARTS) else value


def number_cells(rows: Cells) -> list[str]:
    """Numbers, or tuples of them, as cells: each the shortest text that reads back as the same number, as JSON has it.

    All of them by one call of pydantic's encoder: several times as fast as repr(), number by number.
    """
    text = to_json(rows).decode().replace("null", "")
    return text[2:-2].split("],[") if text.startswith("[[") else text[1:-1].split(",")


def _texts(some: PartOfBatch, shared: dict[Part, ConvertedOnce[Cell | Row, str]]) -> Sequence[str]:
    match some.part.type:
        case "id":
            return cast("Sequence[str]", some.rows)
        case "numbers":
            return number_cells(some.rows)
        case "shared":
            return shared[some.part].of(some.rows)


def _cells(columns: tuple[Column, ...], words: ConvertedOnce[Cell, str], values: Cell | Row) -> str:
    return ",".join(
        [_cell(column.type, words, value) for column, value in zip(columns, as_row(columns, values), strict=True)]
    )


def _cell(column_type: ColumnType, words: ConvertedOnce[Cell, str], value: Cell) -> str:
    match column_type:
        case "word" | "words":
            return words[value]
        case "number" | "integer":
            return number_cells([value])[0]
        case "boolean" | "id" | "instant" | "day":  # nothing in them that CSV would quote
            return "" if value is None else str(value)


def _word(value: object) -> str:
    buffer = io.StringIO()
    # one cell more, since a row of one empty cell would be quoted to show that it is there
    csv.writer(buffer, lineterminator="").writerow([safe_cell(value), ""])
    return buffer.getvalue()[:-1]
