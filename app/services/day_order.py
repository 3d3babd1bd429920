"""A range of days, or of instants, that is asked for runs forwards."""

from datetime import date
from typing import TypeVar

from app.errors import InvalidInputError

T = TypeVar("T", bound=date)  # an instant is a date too


def require_order(first: T | None, last: T | None) -> None:
    """Raises InvalidInputError (`days_reversed`) where both ends are named and the first lies after the last."""
    if first is not None and last is not None and first > last:
        raise InvalidInputError(f"from ({first}) lies after to ({last}).", code="days_reversed")
