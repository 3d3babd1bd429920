"""Batches as NDJSON: an object a line, as a JSON page has them but for the food, which is food_key and food_name."""

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from app.exports.cells import Words, number_texts
from app.exports.record_columns import Batch, Column


def encode_ndjson(columns: Sequence[Column], batches: Iterable[Batch]) -> Iterator[bytes]:
    """Each batch's rows; nothing at all of no rows."""
    words = Words(lambda text: json.dumps(text, ensure_ascii=False))
    line = "{" + ",".join(f'"{column.name}":%s' for column in columns) + "}\n"
    for batch in batches:
        cells = [_cells(column, values, words) for column, values in zip(columns, batch, strict=True)]
        yield "".join(line % row for row in zip(*cells, strict=True)).encode()


def _cells(column: Column, values: list[Any], words: Words) -> list[str]:
    match column.type:
        case "number" | "integer":
            return number_texts(values)
        case "boolean":
            return ["true" if value else "false" for value in values]
        case "words":
            return [json.dumps(value, ensure_ascii=False) if value else "[]" for value in values]
        case "word":
            return words(values)
        case "id" | "instant" | "day":
            return [f'"{value}"' for value in values]
