"""SQL of exported meals and photographs: of a page of meals, the meals, their records, runs and photographs."""

import uuid
from collections.abc import Sequence
from datetime import date, datetime
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyRow
from app.exports.tables.record_queries import coordinates
from app.foods.models import Food
from app.meals.day_models import DiaryDay
from app.meals.models import Meal, MealImage
from app.meals.record_models import HEADLINE_COLUMNS, EffectiveRecord, Item, Run
from app.people.models import Participant, Study
from app.photos.slots import SLOTS
from app.records.conditions import needs_look


class ExportedMeal(NamedTuple):
    """A meal with the names that go with it; without long texts."""

    id: uuid.UUID
    client_id: uuid.UUID
    participant_id: uuid.UUID
    study_code: str
    participant_code: str
    captured_at: datetime
    utc_offset_minutes: int
    time_zone: str
    local_date: date
    received_at: datetime
    status: str
    origin: str
    failure_code: str | None
    after_status: str | None
    version: int
    day_status: str
    longitude: float | None
    latitude: float | None


class HeldAmounts(NamedTuple):
    """A record that holds, with its amounts of HEADLINE_COLUMNS."""

    food_id: int | None
    food_key: str | None
    consumed_g: float | None
    provisional: bool
    needs_look: bool
    flags: list[str]
    doubt: float
    amounts: tuple[float | None, ...]


class MealRun(NamedTuple):
    """The newest run of a meal's own pair."""

    id: uuid.UUID
    method: str
    pipeline_version: str
    marker: str | None
    food_releases: list[str]


def meals_by_id(session: Session, ids: Sequence[uuid.UUID]) -> list[ExportedMeal]:
    """Return these meals in the order of capture."""
    of_day = sa.and_(DiaryDay.participant_id == Meal.participant_id, DiaryDay.local_date == Meal.local_date)
    query = (
        sa.select(
            Meal.id,
            Meal.client_id,
            Meal.participant_id,
            Study.code,
            Participant.code,
            Meal.captured_at,
            Meal.utc_offset_minutes,
            Meal.time_zone,
            Meal.local_date,
            Meal.received_at,
            Meal.status,
            Meal.origin,
            Meal.failure_code,
            Meal.after_status,
            Meal.version,
            sa.func.coalesce(DiaryDay.status, "open"),
            *coordinates(),
        )
        .join(Study, Study.id == Meal.study_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .outerjoin(DiaryDay, of_day)
        .where(Meal.id.in_(ids))
        .order_by(Meal.captured_at, Meal.id)
    )
    return [ExportedMeal._make(row) for row in session.execute(query)]


def records_of_meals(session: Session, ids: Sequence[uuid.UUID]) -> dict[uuid.UUID, list[HeldAmounts]]:
    """Meal -> its records that hold, in the items' order."""
    record = EffectiveRecord
    query = (
        sa.select(
            record.meal_id,
            record.food_id,
            Food.key,
            record.consumed_g,
            record.provisional,
            sa.and_(*needs_look(record)),
            record.flags,
            record.doubt,
            *(getattr(record, name) for name in HEADLINE_COLUMNS),
        )
        .join(Item, Item.id == record.item_id)
        .outerjoin(Food, Food.id == record.food_id)
        .where(record.meal_id.in_(ids), record.status != "rejected")
        .order_by(record.meal_id, Item.position, record.item_id)
    )
    records: dict[uuid.UUID, list[HeldAmounts]] = {}
    for meal_id, *values in session.execute(query):
        records.setdefault(meal_id, []).append(HeldAmounts._make([*values[:7], tuple(values[7:])]))
    return records


def last_runs(session: Session, ids: Sequence[uuid.UUID]) -> dict[uuid.UUID, MealRun]:
    """Meal -> the newest run of its own pair."""
    query = (
        sa.select(Run.meal_id, Run.id, Run.method, Run.pipeline_version, Run.marker, Run.food_releases)
        .where(Run.meal_id.in_(ids), Run.purpose == "meal")
        .order_by(Run.created_at, Run.id.desc())
    )
    return {meal_id: MealRun._make(values) for meal_id, *values in session.execute(query)}


def images_of_meals(session: Session, ids: Sequence[uuid.UUID]) -> dict[uuid.UUID, list[MealImage]]:
    """Meal -> its photographs, left before right, the meal's own before those after it."""
    places = {slot: place for place, slot in enumerate(SLOTS)}
    images_by_meal: dict[uuid.UUID, list[MealImage]] = {}
    for image in session.scalars(sa.select(MealImage).where(MealImage.meal_id.in_(ids))):
        images_by_meal.setdefault(image.meal_id, []).append(image)
    return {meal_id: sorted(images, key=lambda image: places[image.slot]) for meal_id, images in images_by_meal.items()}


def records_of_days(
    session: Session, participant_ids: Sequence[uuid.UUID], first_day: date, last_day: date
) -> list[AnyRow]:
    """(participant, day, food, grams) of records that hold, of these participants within these days."""
    record = EffectiveRecord
    query = sa.select(record.participant_id, record.local_date, record.food_id, record.consumed_g).where(
        record.participant_id.in_(participant_ids),
        record.local_date.between(first_day, last_day),
        record.status != "rejected",
    )
    return list(session.execute(query.order_by(record.item_id)))
