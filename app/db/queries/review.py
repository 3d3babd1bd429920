"""SQL of review: a meal's history, questions to a participant, and the queue of items by doubt."""

import uuid
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import EffectiveRecord, Food, Meal, MealEvent, Participant, Staff

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


@dataclass(frozen=True, slots=True)
class QueueRow:
    """An item that waits for a reviewer, with what it is of."""

    record: EffectiveRecord
    meal: Meal
    participant_code: str
    food: Food | None


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


def words_about_questions(session: Session, participant_id: uuid.UUID) -> list[tuple[MealEvent, Meal]]:
    """Questions to a participant, the newest first, and behind them all answers and undoings of the same meals."""
    of_person = (
        sa.select(MealEvent, Meal).join(Meal, Meal.id == MealEvent.meal_id).where(Meal.participant_id == participant_id)
    )
    newest = of_person.where(MealEvent.kind == "question").order_by(MealEvent.created_at.desc(), MealEvent.id.desc())
    questions = [(event, meal) for event, meal in session.execute(newest.limit(QUESTIONS_LOOKED_AT))]
    meals = {meal.id for _, meal in questions}
    others = of_person.where(MealEvent.kind.in_(("answer", "undo")), MealEvent.meal_id.in_(meals))
    return questions + [(event, meal) for event, meal in session.execute(others)]


def page_of_queue(
    session: Session, chosen: QueueFilter, *, after: tuple[float, uuid.UUID] | None, limit: int
) -> list[QueueRow]:
    """At most `limit` items that count and no reviewer has spoken of, the most doubtful first, behind `after`."""
    record = EffectiveRecord
    query = (
        sa.select(record, Meal, Participant.code, Food)
        .join(Meal, Meal.id == record.meal_id)
        .join(Participant, Participant.id == record.participant_id)
        .outerjoin(Food, Food.id == record.food_id)
        .where(record.study_id == chosen.study_id, record.reviewed.is_(False), record.status != "rejected")
        .order_by(record.doubt.desc(), record.item_id.desc())
        .limit(limit)
    )
    conditions = {
        record.status: chosen.status,
        Food.key: chosen.food_key,
        record.provisional: chosen.provisional,
        Participant.code: chosen.participant_code,
    }
    for column, value in conditions.items():
        if value is not None:
            query = query.where(column == value)
    if chosen.min_doubt is not None:
        query = query.where(record.doubt >= chosen.min_doubt)
    if after is not None:
        bound = sa.tuple_(sa.literal(after[0], record.doubt.type), sa.literal(after[1], record.item_id.type))
        query = query.where(sa.tuple_(record.doubt, record.item_id) < bound)
    return [QueueRow(*row) for row in session.execute(query)]
