"""A row of the database as one line of JSON and back, every value exactly: the same line from SQLite and PostgreSQL.

Ids, instants (UTC, microseconds) and dates as text, bytes as base64, JSON columns as the text that the database keeps,
so that NULL is null and JSON's null is "null"; a float as its shortest decimal that reads back as the same one, what is
not finite as a word.
"""

import base64
import json
import math
import uuid
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime
from typing import Any

from app.db.layout import ColumnType, TableLayout

NOT_FINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
LEAST_INTEGER, MOST_INTEGER = -(2**63), 2**63 - 1


def row_writer(table: TableLayout) -> Callable[[Sequence[Any]], bytes]:
    """From a row to its line, the line's end included. The line's maker raises TypeError for a value of another type.

    A database that holds such (SQLite may) is to be told of now, not when the backup is needed.
    """
    writers = [_WRITERS[column.type] for column in table.columns]
    dumps = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), check_circular=False).encode

    def write(row: Sequence[Any]) -> bytes:
        values = [
            None if value is None else writer(value) for writer, value in zip(writers, row, strict=True)
        ]  # fmt: skip
        return (dumps(values) + "\n").encode("utf-8", "surrogatepass")

    return write


def row_reader(table: TableLayout) -> Callable[[bytes], list[Any]]:
    """From a line to its row; ValueError, which names the column, for what no row_writer made."""
    columns = [(column.name, _READERS[column.type], column.is_nullable) for column in table.columns]

    def read(line: bytes) -> list[Any]:
        try:
            values = json.loads(line.decode("utf-8", "surrogatepass"), parse_constant=_no_constant)
        except RecursionError as error:
            raise ValueError("nested too deep") from error
        if not isinstance(values, list) or len(values) != len(columns):
            raise ValueError("not the table's columns")  # what was written is wrong, not the call
        row: list[Any] = []
        for value, (name, reader, is_nullable) in zip(values, columns, strict=True):
            if value is None:
                if not is_nullable:
                    raise ValueError(f"{name} is missing")
                row.append(None)
                continue
            try:
                row.append(reader(value))
            except (TypeError, ValueError, OverflowError) as error:
                raise ValueError(f"{name} is of another type") from error
        return row

    return read


def _checked(*types: type) -> Callable[[Any], Any]:
    """The value itself, of exactly one of these types (True is no integer)."""

    def check(value: Any) -> Any:
        if type(value) not in types:
            raise TypeError(type(value).__name__)
        return value

    return check


def _write_float(value: Any) -> float | str:
    number = float(_number(value))
    if math.isfinite(number):
        return number
    if math.isnan(number):
        return "NaN"
    return "Infinity" if number > 0 else "-Infinity"


def _read_float(value: Any) -> float:
    if isinstance(value, str):
        return NOT_FINITE[value] if value in NOT_FINITE else _no_constant(value)
    return float(_number(value))


def _read_integer(value: Any) -> int:
    number: int = _integer(value)
    if not LEAST_INTEGER <= number <= MOST_INTEGER:
        raise ValueError(number)
    return number


def _write_instant(value: datetime) -> str:
    return value.astimezone(UTC).isoformat()


def _read_instant(value: Any) -> datetime:
    instant = datetime.fromisoformat(_text(value))
    if instant.tzinfo is None:
        raise ValueError(value)
    return instant.astimezone(UTC)


def _read_json(value: Any) -> str:
    """The text, which must be JSON."""
    text: str = _text(value)
    try:
        json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    return text


def _read_bytes(value: Any) -> bytes:
    return base64.b64decode(_text(value), validate=True)


def _no_constant(name: str) -> float:
    raise ValueError(name)


_text = _checked(str)
_integer = _checked(int)
_number = _checked(int, float)

_WRITERS: dict[ColumnType, Callable[[Any], Any]] = {
    "uuid": lambda value: str(_checked(uuid.UUID)(value)),
    "instant": _write_instant,
    "date": date.isoformat,
    "json": _text,
    "bytes": lambda value: base64.b64encode(value).decode("ascii"),
    "float": _write_float,
    "integer": _integer,
    "boolean": _checked(bool),
    "text": _text,
}
_READERS: dict[ColumnType, Callable[[Any], Any]] = {
    "uuid": lambda value: uuid.UUID(_text(value)),
    "instant": _read_instant,
    "date": lambda value: date.fromisoformat(_text(value)),
    "json": _read_json,
    "bytes": _read_bytes,
    "float": _read_float,
    "integer": _read_integer,
    "boolean": _checked(bool),
    "text": _text,
}
