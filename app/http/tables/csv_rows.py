"""Batches as CSV (RFC 4180), safe to open in a spreadsheet."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from typing import cast

from pydantic_core import to_json

from app.http.tables.columns import (
    Batch,
    Cell,
    Cells,
    ColumnType,
    ConvertedOnce,
    Part,
    PartOfBatch,
)

# a spreadsheet would compute such a cell; the last four are full-width, as Chinese and Japanese keyboards type them
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
LINE_END = "\r\n"


def encode_csv(parts: Sequence[Part], batches: Iterable[Batch]) -> Iterator[bytes]:
    """The header, then each batch's rows. Lists of words stand in one cell, a blank between; None is an empty cell."""
    words = ConvertedOnce[Cell, str](_word)
    yield (",".join(column.name for part in parts for column in part.columns) + LINE_END).encode()
    for batch in batches:
        texts = (_texts(part.deduplicated(), words) for part in batch)
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


def _texts(part_of_batch: PartOfBatch, words: ConvertedOnce[Cell, str]) -> Sequence[str]:
    match part_of_batch.part.type:
        case "id":
            texts = cast("Sequence[str]", part_of_batch.rows)
        case "numbers":
            texts = number_cells(part_of_batch.rows)
        case "shared":
            cells = (
                _cells(column.type, values, words)
                for column, values in zip(part_of_batch.part.columns, part_of_batch.columns(), strict=True)
            )
            texts = list(map(",".join, zip(*cells, strict=True)))
    return part_of_batch.spread(texts)


def _cells(column_type: ColumnType, values: Sequence[Cell], words: ConvertedOnce[Cell, str]) -> Sequence[str]:
    match column_type:
        case "word" | "words":
            return words.of(values)
        case "number" | "integer":
            return number_cells(values)
        case "boolean" | "id" | "instant" | "local time" | "day":  # nothing in them that CSV would quote
            return ["" if value is None else str(value) for value in values]


def _word(value: object) -> str:
    buffer = io.StringIO()
    # one cell more, since a row of one empty cell would be quoted to show that it is there
    csv.writer(buffer, lineterminator=LINE_END).writerow(
        [safe_cell(value), ""]
    )  # quotes what has a line end's characters
    return buffer.getvalue().removesuffix("," + LINE_END)
