"""What every list takes and gives: `limit`, `cursor`, and `next` as a path that is followed as it stands.

A cursor is opaque: the last row's key, bound to the list and its filters.
"""

import base64
import binascii
import hashlib
import json
import math
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Annotated, Any, Generic, TypeVar, overload
from urllib.parse import urlencode

from fastapi import Query, Request

from app.core.errors import InvalidInputError
from app.http.row_filter import RowFilter

Row = TypeVar("Row")
Value = TypeVar("Value")
First = TypeVar("First")
Second = TypeVar("Second")
Third = TypeVar("Third")
Moment = TypeVar("Moment", bound=date)  # an instant is a date too


Limit = Annotated[int, Query(ge=1, le=1000, description="Rows in the answer, at most.")]
Cursor = Annotated[
    str | None, Query(max_length=600, description="From the page before: follow `next`.")
]
MOST = 2**63 - 1  # what a BIGINT counts


@dataclass(frozen=True, slots=True)
class Page(Generic[Row]):
    """Rows, and the cursor of those behind them or None."""

    rows: list[Row]
    cursor: str | None


@dataclass(frozen=True, slots=True)
class Part(Generic[Value]):
    """A part of a row's key: how it is read.

    A cursor is not signed, so what could not have been written is refused.
    """

    read: Callable[[str], Value]


TEXT: Part[str] = Part(str)
WHOLE_NUMBER: Part[int] = Part(lambda text: _bounded(int(text)))
NUMBER: Part[float] = Part(lambda text: _finite(float(text)))
INSTANT: Part[datetime] = Part(lambda text: datetime.fromisoformat(text).astimezone(UTC))
DAY: Part[date] = Part(date.fromisoformat)
ID: Part[uuid.UUID] = Part(uuid.UUID)


def list_name(name: str, chosen: RowFilter) -> str:
    """Return the name of a list of these filters, to which its cursors are bound."""
    filters = {name: getattr(chosen, name) for name in chosen.set_names}
    return f"{name} {json.dumps(filters, default=str)}"


def encode_cursor(listed: str, *key: object) -> str:
    """The cursor behind the row of this key. listed: the list's name and its filters."""
    value = [" ".join(_text(part) for part in key), _fingerprint(listed)]
    return base64.urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


@overload
def decode_cursor(listed: str, cursor: str | None, one: Part[First], /) -> First | None: ...


@overload
def decode_cursor(
    listed: str, cursor: str | None, one: Part[First], two: Part[Second], /
) -> tuple[First, Second] | None: ...


@overload
def decode_cursor(
    listed: str, cursor: str | None, one: Part[First], two: Part[Second], three: Part[Third], /
) -> tuple[First, Second, Third] | None: ...


def decode_cursor(listed: str, cursor: str | None, /, *parts: Part[Any]) -> Any:
    """The key behind which the page begins, part by part; None: at the start.

    Raises InvalidInputError for what is no cursor of this list. A key of one part may hold spaces.
    """
    if cursor is None:
        return None
    try:
        key, fingerprint = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
        if not isinstance(key, str) or "\0" in key or not isinstance(fingerprint, str):
            raise TypeError  # noqa: TRY301  # all that is no cursor is answered below
        key.encode()  # a lone surrogate is no key of ours
    except (ValueError, TypeError, binascii.Error, RecursionError):
        raise broken_cursor() from None
    if fingerprint != _fingerprint(listed):
        raise InvalidInputError(
            "The cursor belongs to other filters: start again without it.",
            code="cursor_of_other_filters",
        )
    values = _read(key, parts)
    return values[0] if len(parts) == 1 else values


def page_of(
    listed: str, rows: Sequence[Row], limit: int, key: Callable[[Row], object]
) -> Page[Row]:
    """A page out of rows of which one more than the limit was asked for.

    key: of a row; several parts as a tuple.
    """
    if len(rows) <= limit:
        return Page(list(rows), None)
    last = key(rows[limit - 1])
    return Page(
        list(rows[:limit]), encode_cursor(listed, *(last if isinstance(last, tuple) else (last,)))
    )


def all_rows(read: Callable[[str | None], Page[Row]]) -> Iterator[Row]:
    """Yield the rows of all pages. read: cursor -> page."""
    page = read(None)
    yield from page.rows
    while page.cursor is not None:
        page = read(page.cursor)
        yield from page.rows


def next_page(request: Request, cursor: str | None) -> str | None:
    """The path of the page behind this one; None: this is the last."""
    if cursor is None:
        return None
    others = [(key, value) for key, value in request.query_params.multi_items() if key != "cursor"]
    return f"{request.url.path}?{urlencode([*others, ('cursor', cursor)])}"


def require_order(first: Moment | None, last: Moment | None) -> None:
    """Raises InvalidInputError (`days_reversed`) where both ends are named and the first lies after the last."""
    wrong = reversed_range_message(first, last)
    if wrong is not None:
        raise InvalidInputError(wrong, code="days_reversed")


def reversed_range_message(first: Moment | None, last: Moment | None) -> str | None:
    """The sentence for a range that runs backwards, the same wherever one is asked for; None: it does not."""
    if first is None or last is None or first <= last:
        return None
    what = "moment" if isinstance(first, datetime) else "day"
    return f"The first {what} lies after the last: {first}, {last}."


def broken_cursor() -> InvalidInputError:
    """The error for a cursor that is none."""
    return InvalidInputError(
        "The cursor is broken: follow `next` of the page before it.", code="cursor_invalid"
    )


def _read(key: str, parts: Sequence[Part[Any]]) -> tuple[Any, ...]:
    """The key's values, each in the one way that encode_cursor writes it."""
    texts = key.split(" ") if len(parts) > 1 else [key]
    try:
        values = tuple(part.read(text) for part, text in zip(parts, texts, strict=True))
    except (ValueError, OverflowError):
        raise broken_cursor() from None
    if [_text(value) for value in values] != texts:
        raise broken_cursor()
    return values


def _text(part: object) -> str:
    match part:
        case uuid.UUID():
            return part.hex
        case datetime():
            return part.astimezone(UTC).isoformat()
        case date():
            return part.isoformat()
        case float():
            return repr(part)
        case _:
            return str(part)


def _bounded(number: int) -> int:
    if not 0 <= number <= MOST:
        raise ValueError(number)
    return number


def _finite(number: float) -> float:
    if not math.isfinite(number):
        raise ValueError(number)
    return number


def _fingerprint(listed: str) -> str:
    return hashlib.sha256(listed.encode()).hexdigest()[:16]
