"""Small lists as flat tables, CSV or NDJSON, from what the API tells of each row: no column list of their own.

What is nested is a column each, its names joined by `_` (food.key -> food_key); a list of words or numbers stands in
one CSV cell, a blank between; what is a list of objects, or free, is JSON text there. Text that a spreadsheet would
compute has an apostrophe before it.
"""

import csv
import io
import json
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, Literal

from pydantic import BaseModel, JsonValue
from pydantic_core import to_json

# a spreadsheet would compute such a cell; the last four are full-width, as Chinese and Japanese
# keyboards type them
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
ROWS_A_PIECE = 500
Path = tuple[str, ...]
FlatFormat = Literal["csv", "ndjson"]


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would take for a formula, with an apostrophe; a list in one cell."""
    if isinstance(value, list | tuple):
        value = " ".join(map(str, value))
    if isinstance(value, str) and value.startswith(FORMULA_STARTS):
        return f"'{value}"
    return value


def flat_paths(model: type[BaseModel], rows: Iterable[Mapping[str, JsonValue]] = ()) -> list[Path]:
    """Where each column's value is in a row, from left to right. rows: all of them, where the model has free names."""
    return list(_paths(model, (), list(rows)))


def encode_flat(
    output: FlatFormat, paths: Sequence[Path], rows: Iterable[Mapping[str, JsonValue]]
) -> Iterator[bytes]:
    """Rows as JSON has them, in pieces; of no rows CSV still has its header."""
    names = ["_".join(path) for path in paths]
    left = iter(rows)
    if output == "csv":
        yield _lines([names])
    while piece := list(islice(left, ROWS_A_PIECE)):
        values = ([_at(row, path) for path in paths] for row in piece)
        if output == "csv":
            yield _lines([_cell(value) for value in row] for row in values)
        else:
            yield b"".join(to_json(dict(zip(names, row, strict=True))) + b"\n" for row in values)


def _paths(
    model: type[BaseModel], prefix: Path, rows: Sequence[Mapping[str, JsonValue]]
) -> Iterator[Path]:
    for name, field in model.model_fields.items():
        column = field.serialization_alias or name
        yield from _paths_of(
            field.annotation, (*prefix, column), [row[column] for row in rows if row.get(column)]
        )


def _paths_of(annotation: object, path: Path, values: Sequence[JsonValue]) -> Iterator[Path]:
    """Of a field. values: those that it has anywhere, which tell the names of a dict."""
    inner = _without_none(annotation)
    members = [value for value in values if isinstance(value, dict)]
    if isinstance(inner, type) and issubclass(inner, BaseModel):
        yield from _paths(inner, path, members)
    elif typing.get_origin(inner) is dict and typing.get_args(inner)[1] not in (Any, object):
        for name in dict.fromkeys(name for value in members for name in value):
            yield from _paths_of(
                typing.get_args(inner)[1], (*path, name), [v[name] for v in members if v.get(name)]
            )
    else:
        yield path


def _without_none(annotation: object) -> object:
    """X of X | None; anything else as it is."""
    if typing.get_origin(annotation) in (types.UnionType, typing.Union):
        others = [one for one in typing.get_args(annotation) if one is not type(None)]
        return others[0] if len(others) == 1 else annotation
    return annotation


def _at(row: Mapping[str, JsonValue], path: Path) -> JsonValue:
    value: JsonValue = dict(row)
    for name in path:
        value = value.get(name) if isinstance(value, dict) else None
    return value


def _cell(value: JsonValue) -> object:
    if isinstance(value, dict) or (
        isinstance(value, list) and any(isinstance(member, dict | list) for member in value)
    ):
        return safe_cell(json.dumps(value, sort_keys=True, ensure_ascii=False))
    if isinstance(value, float):
        return to_json(value).decode()  # the shortest text that reads back as the same number
    return safe_cell(value)


def _lines(rows: Iterable[Sequence[object]]) -> bytes:
    buffer = io.StringIO(newline="")
    csv.writer(buffer).writerows(rows)
    return buffer.getvalue().encode()
