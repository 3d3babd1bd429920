"""A meal's history in pages, and who said what: staff see names, a participant sees whether it was a reviewer."""

import uuid
from dataclasses import dataclass

from app.db.models import MealEvent
from app.db.queries import review
from app.db.session import Database
from app.services.caller import Caller, DeviceCaller
from app.services.cursors import Page, broken_cursor, decode_cursor, encode_cursor
from app.services.read_meal import find_meal


@dataclass(frozen=True, slots=True)
class HistoryRow:
    """An event, its author as this caller may know them, and whether it was taken back."""

    event: MealEvent
    author: str
    is_undone: bool


def read_history(
    database: Database,
    caller: Caller,
    client_id: uuid.UUID,
    participant_code: str | None,
    *,
    cursor: str | None,
    limit: int,
) -> Page[HistoryRow]:
    """A page of the meal's events, the oldest first. Raises NotFoundError, ConflictError, InvalidInputError."""
    with database.read() as session:
        meal, code, _ = find_meal(session, caller, client_id, participant_code)
        listed = f"events/{meal.id}"
        key = decode_cursor(listed, cursor)
        after = _sequence(key) if key is not None else 0
        found = review.page_of_events(session, meal.id, after=after, limit=limit + 1)
        undone = review.undone_events(session, meal.id)
    rows = [
        HistoryRow(event, event.layer if isinstance(caller, DeviceCaller) else name or code, str(event.id) in undone)
        for event, name in found[:limit]
    ]
    is_last = len(found) <= limit
    return Page(rows, None if is_last else encode_cursor(listed, str(rows[-1].event.sequence)))


def _sequence(key: str) -> int:
    if not (key.isascii() and key.isdigit() and len(key) < 10):
        raise broken_cursor()
    return int(key)
