"""What waits for a reviewer in a study, the most doubtful item first, and a participant's open questions.

For the review page, items also have their outline, photograph and the interval of their energy.
"""

import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from sqlalchemy.orm import Session

from app.candidates.item_candidates import ItemCandidates, candidates_of_records
from app.core.errors import NotFoundError
from app.db.session import Database
from app.foods.models import Food
from app.http.paging import ID, NUMBER, Page, decode_cursor, page_of
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.access.caller import DeviceCaller, StaffCaller
from app.records.read_meal import find_meal
from app.records.review import queries as review
from app.records.review.meal_history import HistoryRow
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

    An item whose doubt changes between two pages may come twice or not at all: a reviewer starts at
    the head again.
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


MOST_EVENTS = 20  # of others since the item was read; the rest is in the meal's history


@dataclass(frozen=True, slots=True)
class ReviewItem:
    """An item to review.

    energy: the 90 % interval of what was eaten
    photograph: the left one, None: there is none, or it was erased
    last_event: the number of the newest event of the meal
    """

    row: QueueRow
    candidates: ItemCandidates
    energy: tuple[float, float] | None
    photograph: MealImage | None
    last_event: int

    @property
    def rings(self) -> Sequence[Sequence[Sequence[float]]]:
        """Its current outline, upright pixels of the left photograph."""
        rings = self.row.record.details["rings"]
        return self.row.item.rings if rings is None else rings


@dataclass(frozen=True, slots=True)
class ItemNow:
    """An item, and the events of its meal since it was read, oldest first."""

    item: ReviewItem
    said: tuple[HistoryRow, ...]


def read_review_page(
    database: Database, chosen: QueueFilter, *, cursor: str | None, limit: int
) -> Page[ReviewItem]:
    """Return a page of the queue, most doubtful first: the same rows as `read_queue`.

    Raises InvalidInputError.
    """
    with database.read() as session:
        page = read_rows(session, chosen, cursor=cursor, limit=limit)
        return Page(review_items(session, page.rows), page.cursor)


def count_waiting(database: Database, chosen: QueueFilter, most: int) -> int:
    """Count the items in the queue, up to `most`."""
    with database.read() as session:
        return review.count_queue(session, chosen, most)


def count_meals_to_look_at(database: Database, study_id: uuid.UUID) -> int:
    """Count the meals that have an item in the queue, up to 1,000."""
    with database.read() as session:
        return review.count_meals_to_look_at(session, study_id)


def read_review_item(
    database: Database,
    caller: StaffCaller,
    client_id: uuid.UUID,
    participant_code: str,
    item_id: uuid.UUID,
    *,
    seen: int,
) -> ItemNow:
    """Read an item, in the queue or not; seen: sequence number of the last event that the reader has.

    Raises NotFoundError (`item_not_found`: measured again since, or never there), NotAllowedError,
    ConflictError.
    """
    with database.read() as session:
        meal, code, _ = find_meal(session, caller, client_id, participant_code)
        record, item = session.get(EffectiveRecord, item_id), session.get(Item, item_id)
        if record is None or item is None or record.meal_id != meal.id:
            raise NotFoundError("This meal has no such item.", code="item_not_found")
        food = session.get(Food, record.food_id) if record.food_id is not None else None
        shown = review_items(session, [QueueRow(record, meal, code, food, item)])[0]
        events = review.page_of_events(session, meal.id, after=seen, limit=MOST_EVENTS)
        undone = review.undone_events(session, meal.id)
    history = tuple(
        HistoryRow(event, name or code, str(event.id) in undone) for event, name in events
    )
    return ItemNow(shown, history)


def review_items(session: Session, rows: Sequence[QueueRow]) -> list[ReviewItem]:
    """Return the rows with all that is shown of them."""
    meals = {row.meal.id for row in rows}
    photographs = review.left_photographs(session, meals)
    last_events = review.last_events(session, meals)
    candidates = candidates_of_records(session, [(row.record, row.item) for row in rows])
    return [
        ReviewItem(
            row=row,
            candidates=candidates[row.record.item_id],
            energy=row.record.nutrient_intervals()["energy_kcal"],
            photograph=photographs.get(row.meal.id),
            last_event=last_events.get(row.meal.id, 0),
        )
        for row in rows
    ]
