"""A range of days, or of instants, that is asked for runs forwards."""

from datetime import date, datetime
from typing import TypeVar

from app.core.errors import InvalidInputError

T = TypeVar("T", bound=date)  # an instant is a date too


def require_order(first: T | None, last: T | None) -> None:
    """Raises InvalidInputError (`days_reversed`) where both ends are named and the first lies after the last."""
    wrong = told_reversed(first, last)
    if wrong is not None:
        raise InvalidInputError(wrong, code="days_reversed")


def told_reversed(first: T | None, last: T | None) -> str | None:
    """The sentence for a range that runs backwards, the same wherever one is asked for; None: it does not."""
    if first is None or last is None or first <= last:
        return None
    what = "moment" if isinstance(first, datetime) else "day"
    return f"The first {what} lies after the last: {first}, {last}."
