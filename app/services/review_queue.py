"""What waits for a reviewer in a study, the most doubtful item first; what waits for a participant: open questions."""

import uuid
from dataclasses import asdict, dataclass

from app.db.models import Food, ItemCandidate, Meal, MealEvent
from app.db.queries import review
from app.db.queries.review import QueueFilter, QueueRow
from app.db.session import Database
from app.services.caller import DeviceCaller
from app.services.cursors import Page, broken_cursor, decode_cursor, encode_cursor

MOST_QUESTIONS = 100  # that are shown; when some are answered, others follow


@dataclass(frozen=True, slots=True)
class QueuedItem:
    """An item and the foods that it may be, best first."""

    row: QueueRow
    candidates: tuple[tuple[Food, ItemCandidate], ...]


def read_queue(database: Database, chosen: QueueFilter, *, cursor: str | None, limit: int) -> Page[QueuedItem]:
    """A page of the queue. Raises InvalidInputError for a cursor that is none of these filters.

    An item whose doubt changes between two pages may come twice or not at all: a reviewer starts at the head again.
    """
    listed = f"review-queue/{sorted((name, str(value)) for name, value in asdict(chosen).items())}"
    key = decode_cursor(listed, cursor)
    after = _place(key) if key is not None else None
    with database.read() as session:
        rows = review.page_of_queue(session, chosen, after=after, limit=limit + 1)
        candidates = review.candidates_of(session, [row.record.item_id for row in rows])
    shown = [QueuedItem(row, tuple(candidates.get(row.record.item_id, ()))) for row in rows[:limit]]
    if len(rows) <= limit:
        return Page(shown, None)
    last = shown[-1].row.record
    return Page(shown, encode_cursor(listed, f"{last.doubt!r} {last.item_id}"))


def open_questions(database: Database, caller: DeviceCaller) -> list[tuple[MealEvent, Meal]]:
    """Questions to the participant that are neither answered nor taken back, the newest first; at most 100."""
    with database.read() as session:
        words = review.words_about_questions(session, caller.participant_id)
    undone = {str(event.new["event"]) for event, _ in words if event.kind == "undo"}
    answered = {
        str(event.new["question"]) for event, _ in words if event.kind == "answer" and str(event.id) not in undone
    }
    closed = undone | answered
    found = [(event, meal) for event, meal in words if event.kind == "question" and str(event.id) not in closed]
    return found[:MOST_QUESTIONS]


def _place(key: str) -> tuple[float, uuid.UUID]:
    try:
        doubt, item_id = key.split(" ")
        return float(doubt), uuid.UUID(item_id)
    except ValueError:
        raise broken_cursor() from None
