"""Items for a reviewer's eyes: what the queue tells of them, and outline, photograph and energy's doubt beside it."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.core.errors import NotFoundError
from app.db.session import Database
from app.foods.food_amounts import RECORD_COLUMNS
from app.foods.models import Food
from app.http.cursors import Page
from app.meals.item_state import ItemState
from app.meals.meal_parts import MealParts, parts_of
from app.meals.models import MealImage
from app.meals.record_models import EffectiveRecord, ItemCandidate
from app.nutrition.doubt import Estimate
from app.people.access.caller import StaffCaller
from app.records.project_records import ItemProjection, Projector
from app.records.read_meal import find_meal
from app.records.review import queries as review
from app.records.review.meal_history import HistoryRow
from app.records.review.queries import QueueFilter, QueueRow
from app.records.review.review_queue import read_rows

MOST_WORDS = 20  # that are told of what others said meanwhile; the rest stands in the meal's history


@dataclass(frozen=True, slots=True)
class ReviewItem:
    """An item as it stands. candidates: best first; none_probability: that it is none of them.

    energy: of what was eaten. photograph: the left one, None where there is none (any more). last_event: the number
    of the newest word about the meal that is in it.
    """

    row: QueueRow
    state: ItemState
    candidates: tuple[tuple[Food, ItemCandidate], ...]
    none_probability: float | None
    energy: Estimate | None
    photograph: MealImage | None
    last_event: int


@dataclass(frozen=True, slots=True)
class ItemNow:
    """One item as it stands, and what was said of its meal since it was read: the oldest first."""

    item: ReviewItem
    said: tuple[HistoryRow, ...]


def read_review_page(database: Database, chosen: QueueFilter, *, cursor: str | None, limit: int) -> Page[ReviewItem]:
    """A page of the queue, the most doubtful first: the same rows as `read_queue`. Raises InvalidInputError."""
    with database.read() as session:
        page = read_rows(session, chosen, cursor=cursor, limit=limit)
        return Page(_items(session, page.rows), page.cursor)


def count_waiting(database: Database, chosen: QueueFilter, most: int) -> int:
    """How many items wait, counted up to `most`."""
    with database.read() as session:
        return review.count_queue(session, chosen, most)


def read_review_item(
    database: Database,
    caller: StaffCaller,
    client_id: uuid.UUID,
    participant_code: str,
    item_id: uuid.UUID,
    *,
    seen: int,
) -> ItemNow:
    """An item of a meal, in the queue or not any more; seen: number of the last event that the reader knows.

    Raises NotFoundError (`item_not_found`: measured again since, or never there), NotAllowedError, ConflictError.
    """
    with database.read() as session:
        meal, code, _ = find_meal(session, caller, client_id, participant_code)
        record = session.get(EffectiveRecord, item_id)
        food = session.get(Food, record.food_id) if record is not None and record.food_id is not None else None
        found = _items(session, [QueueRow(record, meal, code, food)] if record and record.meal_id == meal.id else [])
        if not found:
            raise NotFoundError("This meal has no such item.", code="item_not_found")
        events = review.page_of_events(session, meal.id, after=seen, limit=MOST_WORDS)
        undone = review.undone_events(session, meal.id)
    said = tuple(HistoryRow(event, name or code, str(event.id) in undone) for event, name in events)
    return ItemNow(found[0], said)


def _items(session: Session, rows: Sequence[QueueRow]) -> list[ReviewItem]:
    """Without those that a new run has taken the place of, since the rows were read."""
    meals = {row.meal.id: row.meal for row in rows}
    photographs = review.left_photographs(session, meals)
    projector = Projector(session)
    projected: dict[uuid.UUID, tuple[MealParts, ItemProjection]] = {}
    for parts in parts_of(session, list(meals.values())):
        projected |= {item.state.item.id: (parts, item) for item in projector.project(parts).items}
    shown = []
    for row in rows:
        if row.record.item_id in projected:
            parts, item = projected[row.record.item_id]
            shown.append(_item(row, parts, item, projector, photographs.get(row.meal.id)))
    return shown


def _item(
    row: QueueRow, parts: MealParts, found: ItemProjection, projector: Projector, photograph: MealImage | None
) -> ReviewItem:
    nutrients = found.amounts.nutrients if found.amounts is not None else {}
    return ReviewItem(
        row=row,
        state=found.state,
        candidates=tuple((projector.food(one.food_id), one) for one in found.candidates.all),
        none_probability=found.candidates.none_probability,
        energy=next((nutrients[one] for one in RECORD_COLUMNS["energy_kcal"] if one in nutrients), None),
        photograph=photograph,
        last_event=max((event.sequence for event in parts.events), default=0),
    )
