"""SQL of review: a meal's history, questions to a participant, and the queue of items by doubt."""

import uuid
from collections.abc import Collection
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import Meal, MealImage, MealOrigin
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord, Item
from app.people.models import Participant, Staff, Study
from app.records.double_review.drawn import is_blind
from app.records.page_queries import MOST_BRANCHES, food_ids, meal_is, needs_look, participants_of

QUEUED_STATUSES = tuple(status for status in RECORD_STATUSES if status != "rejected")
MOST_MEALS = 1000  # that need a look, as they are counted
QUESTIONS_LOOKED_AT = 1000  # of one participant, the newest


@dataclass(frozen=True, slots=True)
class QueueFilter:
    """Which items of a study: None leaves a filter out."""

    study_id: uuid.UUID
    status: str | None = None
    food_key: str | None = None
    min_doubt: float | None = None
    provisional: bool | None = None
    participant_code: str | None = None
    origin: MealOrigin | None = None


@dataclass(frozen=True, slots=True)
class QueueRow:
    """An item that waits for a reviewer, with what it is of."""

    record: EffectiveRecord
    meal: Meal
    participant_code: str
    food: Food | None
    item: Item


def page_of_events(
    session: Session, meal_id: uuid.UUID, *, after: int, limit: int
) -> list[tuple[MealEvent, str | None]]:
    """(event, staff's name; None: a phone's) in their order, those behind the sequence number `after`."""
    query = (
        sa.select(MealEvent, Staff.name)
        .outerjoin(Staff, Staff.id == MealEvent.staff_id)
        .where(MealEvent.meal_id == meal_id, MealEvent.sequence > after)
        .order_by(MealEvent.sequence)
        .limit(limit)
    )
    return [(event, name) for event, name in session.execute(query)]


def undone_events(session: Session, meal_id: uuid.UUID) -> set[str]:
    """Ids of a meal's events that were taken back."""
    query = sa.select(MealEvent.new).where(MealEvent.meal_id == meal_id, MealEvent.kind == "undo")
    return {str(new["event"]) for new in session.scalars(query)}


def last_events(session: Session, meal_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, int]:
    """Meal -> the number of its newest event; meals without events are left out."""
    query = (
        sa.select(MealEvent.meal_id, sa.func.max(MealEvent.sequence))
        .where(MealEvent.meal_id.in_(list(meal_ids)))
        .group_by(MealEvent.meal_id)
    )
    sequences: dict[uuid.UUID, int] = dict(session.execute(query).all())
    return sequences


def words_about_questions(
    session: Session, participant_id: uuid.UUID
) -> list[tuple[MealEvent, Meal]]:
    """Questions to a participant, the newest first, and behind them all answers and undoings of the same meals."""
    of_person = (
        sa.select(MealEvent, Meal)
        .join(Meal, Meal.id == MealEvent.meal_id)
        .where(Meal.participant_id == participant_id)
    )
    newest = of_person.where(MealEvent.kind == "question").order_by(
        MealEvent.created_at.desc(), MealEvent.id.desc()
    )
    questions = [
        (event, meal) for event, meal in session.execute(newest.limit(QUESTIONS_LOOKED_AT))
    ]
    meals = {meal.id for _, meal in questions}
    others = of_person.where(MealEvent.kind.in_(("answer", "undo")), MealEvent.meal_id.in_(meals))
    return questions + [(event, meal) for event, meal in session.execute(others)]


def page_of_queue(
    session: Session, chosen: QueueFilter, *, after: tuple[float, uuid.UUID] | None, limit: int
) -> list[QueueRow]:
    """At most `limit` items that need a look (conditions.needs_look), the most doubtful first, behind `after`."""
    page = queue_keys(session, chosen, after=after, limit=limit)
    if page is None:
        return []
    record = EffectiveRecord
    query = (
        sa.select(record, Meal, Participant.code, Food, Item)
        .select_from(page.join(record, record.item_id == page.c.item_id))
        .join(Meal, Meal.id == record.meal_id)
        .join(Item, Item.id == record.item_id)
        .join(Participant, Participant.id == record.participant_id)
        .outerjoin(Food, Food.id == record.food_id)
        .order_by(page.c.doubt.desc(), page.c.item_id.desc())
    )
    return [QueueRow(*row) for row in session.execute(query)]


def count_queue(session: Session, chosen: QueueFilter, most: int) -> int:
    """How many items wait for a reviewer, counted up to `most`: no more of an index is read."""
    page = queue_keys(session, chosen, after=None, limit=most)
    return 0 if page is None else session.scalar(sa.select(sa.func.count()).select_from(page)) or 0


def count_meals_to_look_at(session: Session, study_id: uuid.UUID) -> int:
    """How many meals of the study have an item that needs a look, counted up to MOST_MEALS."""
    record = EffectiveRecord
    # as an index has them, so that no more of it is read
    in_order = (record.captured_at, record.meal_id)
    meals = sa.select(*in_order).where(record.study_id == study_id, *needs_look(record)).distinct()
    counted = meals.order_by(*in_order).limit(MOST_MEALS).subquery()
    return session.scalar(sa.select(sa.func.count()).select_from(counted)) or 0


def left_photographs(
    session: Session, meal_ids: Collection[uuid.UUID]
) -> dict[uuid.UUID, MealImage]:
    """Meal -> its left photograph, of those that have one that is not erased."""
    query = sa.select(MealImage).where(
        MealImage.meal_id.in_(list(meal_ids)),
        MealImage.slot == "left",
        MealImage.erased_at.is_(None),
    )
    return {image.meal_id: image for image in session.scalars(query)}


def queue_keys(
    session: Session, chosen: QueueFilter, *, after: tuple[float, uuid.UUID] | None, limit: int
) -> sa.CTE | None:
    """Which items are on a page: their doubt and item_id, from an index that has them in this order; in no order.

    None: the filter names what is not there.
    """
    record, branches = EffectiveRecord, _branches(session, chosen)
    if not branches:
        return None
    conditions = [record.study_id == chosen.study_id, *needs_look(record)]
    study = session.get_one(Study, chosen.study_id)
    if study.double_review is not None:
        conditions.append(~is_blind(study))
    if chosen.origin is not None:
        conditions.append(meal_is(record.meal_id, [Meal.origin == chosen.origin]))
    if chosen.min_doubt is not None:
        conditions.append(record.doubt >= chosen.min_doubt)
    if after is not None:
        bound = sa.tuple_(
            sa.literal(after[0], record.doubt.type), sa.literal(after[1], record.item_id.type)
        )
        conditions.append(sa.tuple_(record.doubt, record.item_id) < bound)
    parts = [
        sa.select(record.doubt, record.item_id).where(*conditions, *branch) for branch in branches
    ]
    # all that there is of a person, and sorted then: not the study's in order
    if chosen.participant_code is not None:
        parts = [sa.select(part.cte("of_person").prefix_with("MATERIALIZED")) for part in parts]
    elif session.get_bind().dialect.name != "sqlite":  # as in record_pages.RecordSearch
        order = (record.doubt.desc(), record.item_id.desc())
        parts = [sa.select(part.order_by(*order).limit(limit).subquery()) for part in parts]
    every = sa.union_all(*parts).subquery("branch")
    return (
        sa.select(every)
        .order_by(every.c.doubt.desc(), every.c.item_id.desc())
        .limit(limit)
        .cte("page")
    )


def _branches(session: Session, chosen: QueueFilter) -> list[tuple[sa.ColumnElement[bool], ...]]:
    """What to read, each from an index in the queue's order; nothing where the filter names what is not there.

    A person has some thousand records, and an after-meal pair is waited for at few meals: there the
    other filters are compared row by row.
    """
    record = EffectiveRecord
    statuses = QUEUED_STATUSES if chosen.status is None else (chosen.status,)
    food_ids_named = None if chosen.food_key is None else food_ids(session, (chosen.food_key,))
    rest: list[sa.ColumnElement[bool]] = []
    if chosen.provisional is not None:
        rest.append(record.provisional.is_(chosen.provisional))
    if chosen.participant_code is not None or chosen.provisional:
        rest.append(record.status.in_(statuses))
        if food_ids_named is not None:
            rest.append(record.food_id.in_(food_ids_named))
        if chosen.participant_code is None:
            return [tuple(rest)]
        people = participants_of(session, chosen.participant_code, None, [chosen.study_id]) or ()
        return [(record.participant_id == person, *rest) for person in people]
    if food_ids_named is not None and len(food_ids_named) * len(statuses) > MOST_BRANCHES:
        # the study's in their order, and those of other foods passed by
        rest.append(record.food_id.in_(food_ids_named))
    elif food_ids_named is not None:
        return [
            (record.food_id == food, record.status == status, *rest)
            for food in food_ids_named
            for status in statuses
        ]
    return [(record.status == status, *rest) for status in statuses]
