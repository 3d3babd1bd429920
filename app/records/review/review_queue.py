"""What waits for a reviewer in a study, the most doubtful item first; what waits for a participant: open questions."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from sqlalchemy.orm import Session

from app.candidates.item_candidates import ItemCandidates, candidates_of_records
from app.db.session import Database
from app.http.paging import ID, NUMBER, Page, decode_cursor, page_of
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import Meal
from app.people.access.caller import DeviceCaller
from app.records.review import queries as review
from app.records.review.queries import QueueFilter, QueueRow

MOST_QUESTIONS = 100  # that are shown; when some are answered, others follow


@dataclass(frozen=True, slots=True)
class QueuedItem:
    """An item and the foods that it may be."""

    row: QueueRow
    candidates: ItemCandidates


def read_queue(
    database: Database, chosen: QueueFilter, *, cursor: str | None, limit: int
) -> Page[QueuedItem]:
    """A page of the queue. Raises InvalidInputError for a cursor that is none of these filters.

    An item whose doubt changes between two pages may come twice or not at all: a reviewer starts at the head again.
    """
    with database.read() as session:
        page = read_rows(session, chosen, cursor=cursor, limit=limit)
        return Page(_with_candidates(session, page.rows), page.cursor)


def read_rows(
    session: Session, chosen: QueueFilter, *, cursor: str | None, limit: int
) -> Page[QueueRow]:
    """A page of the queue's rows alone; what is shown of each, `read_queue` and review_items.py add. Raises as it."""
    listed = f"review-queue/{sorted((name, str(value)) for name, value in asdict(chosen).items())}"
    rows = review.page_of_queue(
        session, chosen, after=decode_cursor(listed, cursor, NUMBER, ID), limit=limit + 1
    )
    return page_of(listed, rows, limit, lambda row: (row.record.doubt, row.record.item_id))


def open_questions(database: Database, caller: DeviceCaller) -> list[tuple[MealEvent, Meal]]:
    """Questions to the participant that are neither answered nor taken back, the newest first; at most 100."""
    with database.read() as session:
        words = review.words_about_questions(session, caller.participant_id)
    undone = {str(event.new["event"]) for event, _ in words if event.kind == "undo"}
    answered = {
        str(event.new["question"])
        for event, _ in words
        if event.kind == "answer" and str(event.id) not in undone
    }
    closed = undone | answered
    questions = [
        (event, meal)
        for event, meal in words
        if event.kind == "question" and str(event.id) not in closed
    ]
    return questions[:MOST_QUESTIONS]


def _with_candidates(session: Session, rows: Sequence[QueueRow]) -> list[QueuedItem]:
    candidates = candidates_of_records(session, [(row.record, row.item) for row in rows])
    return [QueuedItem(row, candidates[row.record.item_id]) for row in rows]
