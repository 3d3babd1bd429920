"""SQL of one participant's day: its meals, each with the records that hold."""

import uuid
from datetime import date

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.models import EffectiveRecord, Meal


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
