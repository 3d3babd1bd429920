"""Opaque cursors of lists: the last row's key, bound to the list and its filters."""

import base64
import binascii
import hashlib
import json
from dataclasses import dataclass
from typing import Generic, TypeVar

from app.errors import InvalidInputError

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Page(Generic[Row]):
    """Rows, and the cursor of those behind them or None."""

    rows: list[Row]
    cursor: str | None


def encode_cursor(listed: str, key: str) -> str:
    """The cursor behind the row of this key. listed: the list's name and its filters."""
    return base64.urlsafe_b64encode(json.dumps([key, _fingerprint(listed)]).encode()).decode().rstrip("=")


def decode_cursor(listed: str, cursor: str | None) -> str | None:
    """The key behind which the page begins; None: at the start. Raises InvalidInputError for no cursor of this list."""
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
            "The cursor belongs to other filters: start again without it.", code="cursor_of_other_filters"
        )
    return key


def broken_cursor() -> InvalidInputError:
    """The error for a cursor that is none."""
    return InvalidInputError("The cursor is broken: follow `next` of the page before it.", code="cursor_invalid")


def _fingerprint(listed: str) -> str:
    return hashlib.sha256(listed.encode()).hexdigest()[:16]
