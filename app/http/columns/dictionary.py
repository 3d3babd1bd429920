"""A column, and the data dictionary: name, type, unit, meaning, values, what is empty.

From the columns that the files are written by; as rows, and as a Table Schema (Frictionless Data)
to check a CSV with.
"""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import JsonValue

from app.http.flat_list import safe_cell

ColumnType = Literal[
    "id", "word", "instant", "local time", "day", "number", "integer", "boolean", "words"
]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    type: a "word" is any text; "words" is a list of texts.
    meaning: one or a few sentences for the data dictionary.
    unit: None where the values have none.
    values: all that there can be, where that is a short list.
    empty: what an empty cell says; None: no cell is empty.
    """

    name: str
    type: ColumnType
    meaning: str = ""
    unit: str | None = None
    values: tuple[str, ...] = ()
    empty: str | None = None


DictionaryType = Literal[
    "id", "text", "list of words", "instant", "local time", "day", "number", "integer", "boolean"
]
TYPES: dict[ColumnType, DictionaryType] = {  # in words of the dictionary
    "id": "id",
    "word": "text",
    "words": "list of words",
    "instant": "instant",
    "local time": "local time",
    "day": "day",
    "number": "number",
    "integer": "integer",
    "boolean": "boolean",
}
SCHEMA_TYPES: dict[ColumnType, dict[str, JsonValue]] = {
    "id": {"type": "string", "format": "uuid"},
    "word": {"type": "string"},
    "words": {"type": "string"},  # in one cell, a blank between
    "instant": {"type": "datetime", "format": "any"},
    "local time": {"type": "datetime", "format": "any"},
    "day": {"type": "date"},
    "number": {"type": "number"},
    "integer": {"type": "integer"},
    "boolean": {"type": "boolean", "trueValues": ["True"], "falseValues": ["False"]},
}

DICTIONARY_COLUMNS = (
    Column("position", "integer", "The column's place, 1 the first."),
    Column("name", "word", "The column's name."),
    Column("type", "word", "What its values are.", values=tuple(TYPES.values())),
    Column("unit", "word", "Unit of the values; 1: a share or a ratio.", empty="They have none."),
    Column("meaning", "word", "What the column tells."),
    Column("values", "words", "All values that there can be, where they are few."),
    Column("empty", "word", "What an empty cell says.", empty="There is none."),
)
DictionaryRow = tuple[int, str, DictionaryType, str | None, str, tuple[str, ...], str | None]


def entries(columns: Sequence[Column]) -> list[DictionaryRow]:
    """A row of DICTIONARY_COLUMNS each."""
    return [
        (
            place,
            column.name,
            TYPES[column.type],
            column.unit,
            column.meaning,
            column.values,
            column.empty,
        )
        for place, column in enumerate(columns, start=1)
    ]


def dictionary_csv(rows: Iterable[Sequence[object]], names: Sequence[str] = ()) -> bytes:
    """Rows of DICTIONARY_COLUMNS as a CSV file. names: of columns before them."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer)
    writer.writerow([*names, *(column.name for column in DICTIONARY_COLUMNS)])
    writer.writerows([safe_cell(value) for value in row] for row in rows)
    return buffer.getvalue().encode()


def table_schema(columns: Sequence[Column], *, key: Sequence[str]) -> dict[str, JsonValue]:
    """The CSV file's Table Schema; units stand in `unit`, which is not of the standard but allowed by it."""
    return {
        "fields": [_field(column) for column in columns],
        "missingValues": [""],
        "primaryKey": list(key),
    }


def _field(column: Column) -> dict[str, JsonValue]:
    constraints: dict[str, JsonValue] = {}
    if column.empty is None and column.type not in ("word", "words"):  # text may be the empty text
        constraints["required"] = True
    if column.values:
        constraints["enum"] = list(column.values)
    return {
        "name": column.name,
        **SCHEMA_TYPES[column.type],
        "description": column.meaning
        + (f" Empty: {column.empty}" if column.empty is not None else ""),
        **({"unit": column.unit} if column.unit is not None else {}),
        **({"constraints": constraints} if constraints else {}),
    }
