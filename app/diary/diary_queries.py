"""SQL of the diary: diary entries, a participant's first and last day, and the meals of a day."""

import uuid
from collections.abc import Collection, Iterator
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.diary.models import DayEvent, DiaryDay
from app.meals.models import Meal
from app.meals.record_models import EffectiveRecord
from app.people.models import Participant


def events_of(session: Session, participant_id: uuid.UUID, days: Collection[date]) -> list[DayEvent]:
    """The words about these days, the oldest first."""
    query = (
        sa.select(DayEvent)
        .where(DayEvent.participant_id == participant_id, DayEvent.local_date.in_(days))
        .order_by(DayEvent.created_at, DayEvent.id)
    )
    return list(session.scalars(query))


def first_days(session: Session, participant_ids: Collection[uuid.UUID]) -> dict[uuid.UUID, date]:
    """Participant -> the study's day 1 for them; absent where neither a start, a meal nor a closed day is known."""
    first_meal = sa.select(sa.func.min(Meal.local_date)).where(Meal.participant_id == Participant.id).scalar_subquery()
    first_closed = (
        sa.select(sa.func.min(DiaryDay.local_date))
        .where(DiaryDay.participant_id == Participant.id, DiaryDay.status == "closed")
        .scalar_subquery()
    )
    query = sa.select(Participant.id, Participant.starts_on, first_meal, first_closed)
    found: dict[uuid.UUID, date] = {}
    for ids in _batches(participant_ids):
        for participant_id, starts_on, meal, closed in session.execute(query.where(Participant.id.in_(ids))):
            known = [day for day in (meal, closed) if day is not None]
            if starts_on is not None or known:
                found[participant_id] = starts_on or min(known)
    return found


def number_of(local_date: date, first_day: date | None) -> int | None:
    """The day's number in the study, 1 on the first day; None where no first day is known."""
    return None if first_day is None else (local_date - first_day).days + 1


def count_meals(session: Session, participant_id: uuid.UUID, local_date: date) -> int:
    """How many meals there are on a day."""
    query = (
        sa.select(sa.func.count())
        .select_from(Meal)
        .where(Meal.participant_id == participant_id, Meal.local_date == local_date)
    )
    return session.execute(query).scalar_one()


def meals_of_day(
    session: Session, participant_id: uuid.UUID, local_date: date
) -> list[tuple[Meal, list[EffectiveRecord]]]:
    """The day's meals in their order; records that were rejected are left out, meals without any are there."""
    of_day = sa.select(Meal).where(Meal.participant_id == participant_id, Meal.local_date == local_date)
    meals = session.scalars(of_day.order_by(Meal.captured_at, Meal.id)).all()
    records = sa.select(EffectiveRecord).where(
        EffectiveRecord.meal_id.in_([meal.id for meal in meals]), EffectiveRecord.status != "rejected"
    )
    by_meal: dict[uuid.UUID, list[EffectiveRecord]] = {meal.id: [] for meal in meals}
    for record in session.scalars(records.order_by(EffectiveRecord.item_id)):
        by_meal[record.meal_id].append(record)
    return [(meal, by_meal[meal.id]) for meal in meals]


def lock_participant(session: Session, participant_id: uuid.UUID) -> Participant | None:
    """The participant, locked until commit: words about their days come one after the other. None: erased meanwhile."""
    query = sa.select(Participant).where(Participant.id == participant_id)
    query = query.with_for_update(key_share=True)  # meals may come in all the while
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def _batches(ids: Collection[uuid.UUID], size: int = 500) -> Iterator[list[uuid.UUID]]:
    """So many at a time: a statement takes only so many parameters."""
    every = sorted(set(ids))
    yield from (every[start : start + size] for start in range(0, len(every), size))
