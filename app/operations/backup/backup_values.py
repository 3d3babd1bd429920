"""Convert a row of the database to a line of JSON and back without loss, alike for SQLite and PostgreSQL.

Ids, instants (UTC, microseconds) and dates are text, bytes base64, JSON columns the database's text, so that NULL is
null and JSON's null is "null"; a float is its shortest decimal that reads back equal, or "NaN" or "Infinity".
"""

import base64
import json
import math
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import NoReturn, TypeVar

from app.db.layout import ColumnType, TableLayout

NOT_FINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
LEAST_INTEGER, MOST_INTEGER = -(2**63), 2**63 - 1

ValueT = TypeVar("ValueT")


def row_writer(table: TableLayout) -> Callable[[Sequence[object]], bytes]:
    """Return a function from a row to its line, which raises TypeError for a value of another type.

    Such values (SQLite may have them) must be reported now, not when the backup is needed.
    """
    writers = [_CODECS[column.type].write for column in table.columns]
    dumps = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), check_circular=False).encode

    def write(row: Sequence[object]) -> bytes:
        values = [
            None if value is None else writer(value) for writer, value in zip(writers, row, strict=True)
        ]  # fmt: skip
        return (dumps(values) + "\n").encode("utf-8", "surrogatepass")

    return write


def row_reader(table: TableLayout) -> Callable[[bytes], list[object]]:
    """Return a function from a line to its row, which raises ValueError, naming the column, for an invalid line."""
    columns = [(column.name, _CODECS[column.type].read, column.is_nullable) for column in table.columns]

    def read(line: bytes) -> list[object]:
        values = _parsed(line.decode("utf-8", "surrogatepass"), parse_constant=_no_constant)
        if not isinstance(values, list) or len(values) != len(columns):
            raise ValueError("not the table's columns")  # invalid data, not a wrong call
        row: list[object] = []
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


def _exactly(kind: type[ValueT], value: object) -> ValueT:
    """Return a value of exactly this type (True is not an integer)."""
    if not isinstance(value, kind) or type(value) is not kind:
        raise TypeError(type(value).__name__)
    return value


def _number(value: object) -> float:
    return value if isinstance(value, float) else _exactly(int, value)


def _write_float(value: object) -> float | str:
    number = float(_number(value))
    if math.isfinite(number):
        return number
    if math.isnan(number):
        return "NaN"
    return "Infinity" if number > 0 else "-Infinity"


def _read_float(value: object) -> float:
    if isinstance(value, str):
        return NOT_FINITE[value] if value in NOT_FINITE else _no_constant(value)
    return float(_number(value))


def _integer(value: object) -> int:
    return _exactly(int, value)


def _read_integer(value: object) -> int:
    number = _integer(value)
    if not LEAST_INTEGER <= number <= MOST_INTEGER:
        raise ValueError(number)
    return number


def _text(value: object) -> str:
    return _exactly(str, value)


def _boolean(value: object) -> bool:
    return _exactly(bool, value)


def _read_instant(value: object) -> datetime:
    instant = datetime.fromisoformat(_text(value))
    if instant.tzinfo is None:
        raise ValueError(value)
    return instant.astimezone(UTC)


def _read_json(value: object) -> str:
    """Return a text that is JSON."""
    text = _text(value)
    _parsed(text)
    return text


def _parsed(text: str, parse_constant: Callable[[str], float] | None = None) -> object:
    try:
        parsed: object = json.loads(text, parse_constant=parse_constant)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    return parsed


def _no_constant(name: str) -> NoReturn:
    raise ValueError(name)


@dataclass(frozen=True, slots=True)
class _Codec:
    """write: converts a value of the database to JSON; read: back. Both raise for a value of another type."""

    write: Callable[[object], object]
    read: Callable[[object], object]


_CODECS: dict[ColumnType, _Codec] = {
    "uuid": _Codec(lambda value: str(_exactly(uuid.UUID, value)), lambda value: uuid.UUID(_text(value))),
    "instant": _Codec(lambda value: _exactly(datetime, value).astimezone(UTC).isoformat(), _read_instant),
    "date": _Codec(lambda value: _exactly(date, value).isoformat(), lambda value: date.fromisoformat(_text(value))),
    "json": _Codec(_text, _read_json),
    "bytes": _Codec(
        lambda value: base64.b64encode(_exactly(bytes, value)).decode("ascii"),
        lambda value: base64.b64decode(_text(value), validate=True),
    ),
    "float": _Codec(_write_float, _read_float),
    "integer": _Codec(_integer, _read_integer),
    "boolean": _Codec(_boolean, _boolean),
    "text": _Codec(_text, _text),
}
