"""SQL of the diary: diary entries, a participant's first and last day, and the meals of a day."""

import uuid
from collections.abc import Collection
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.stored.day_models import DayEvent
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord
from app.people.models import Participant


def events_of(
    session: Session, participant_id: uuid.UUID, days: Collection[date]
) -> list[DayEvent]:
    """Return a participant's day events on these days, the oldest first."""
    query = (
        sa.select(DayEvent)
        .where(DayEvent.participant_id == participant_id, DayEvent.local_date.in_(days))
        .order_by(DayEvent.created_at, DayEvent.id)
    )
    return list(session.scalars(query))


def count_meals(session: Session, participant_id: uuid.UUID, local_date: date) -> int:
    """Count a participant's meals on a day."""
    query = (
        sa.select(sa.func.count())
        .select_from(Meal)
        .where(Meal.participant_id == participant_id, Meal.local_date == local_date)
    )
    return session.execute(query).scalar_one()


def meals_of_day(
    session: Session, participant_id: uuid.UUID, local_date: date
) -> list[tuple[Meal, list[EffectiveRecord]]]:
    """Return the day's meals in order, each with its records that are not rejected."""
    query = sa.select(Meal).where(
        Meal.participant_id == participant_id, Meal.local_date == local_date
    )
    meals = session.scalars(query.order_by(Meal.captured_at, Meal.id)).all()
    records = sa.select(EffectiveRecord).where(
        EffectiveRecord.meal_id.in_([meal.id for meal in meals]),
        EffectiveRecord.status != "rejected",
    )
    by_meal: dict[uuid.UUID, list[EffectiveRecord]] = {meal.id: [] for meal in meals}
    for record in session.scalars(records.order_by(EffectiveRecord.item_id)):
        by_meal[record.meal_id].append(record)
    return [(meal, by_meal[meal.id]) for meal in meals]


def lock_participant(session: Session, participant_id: uuid.UUID) -> Participant | None:
    """Lock a participant until commit, so that their day events are written one by one. None: erased meanwhile."""
    query = sa.select(Participant).where(Participant.id == participant_id)
    query = query.with_for_update(key_share=True)  # does not block new meals
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()
