"""Pages of a meal's history. Staff see the authors' names; a participant sees only `participant` or `reviewer`."""

import uuid
from dataclasses import dataclass

from app.db.session import Database
from app.http.paging import WHOLE_NUMBER, Page, decode_cursor, encode_cursor
from app.meals.stored.event_models import MealEvent
from app.people.access.caller import Caller, DeviceCaller
from app.records.read_meal import find_meal
from app.records.review import queries as review


@dataclass(frozen=True, slots=True)
class HistoryRow:
    """An event, its author as far as the caller may see, and whether it was undone."""

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
    """Return a page of the meal's events, oldest first. Raises NotFoundError, ConflictError, InvalidInputError."""
    with database.read() as session:
        meal, code, _ = find_meal(session, caller, client_id, participant_code)
        listed = f"events/{meal.id}"
        after = decode_cursor(listed, cursor, WHOLE_NUMBER)
        events = review.page_of_events(session, meal.id, after=after or 0, limit=limit + 1)
        undone = review.undone_events(session, meal.id)
    rows = [
        HistoryRow(
            event,
            event.layer if isinstance(caller, DeviceCaller) else name or code,
            str(event.id) in undone,
        )
        for event, name in events[:limit]
    ]
    is_last = len(events) <= limit
    return Page(rows, None if is_last else encode_cursor(listed, rows[-1].event.sequence))
