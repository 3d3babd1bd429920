"""SQL of lists of meals: meals with their records that count and whether they have a left photograph.

Also bounded counts of a study's meals by status, and which of some meals have changed or exist.
"""

import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import date
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session, defer

from app.exports.lists.meal_page_queries import keys_of, search_of
from app.foods.models import Food
from app.http.row_filter import RowFilter
from app.meals.stored.models import MEAL_STATUSES, Meal, MealImage
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.models import Participant, Study
from app.records.page_queries import Key, holds


class HeldRecord(NamedTuple):
    """What a list of meals needs of a record that is not rejected. food_name: of the record's version of the food."""

    item_id: uuid.UUID
    status: str
    provisional: bool
    reviewed: bool
    food_key: str | None
    food_name: str | None
    consumed_g: float | None
    energy_kcal: float | None
    doubt: float
    flags: list[str]


class PhotographedMeals(NamedTuple):
    """measured: those whose estimate has ended, from first_day to last_day, if there are any. waiting: for theirs."""

    measured: int
    first_day: date | None
    last_day: date | None
    waiting: int


@dataclass(frozen=True, slots=True)
class MealRow:
    """A meal of a list. records: those that count, in the order of the items.

    has_left: its left photograph has arrived and is not erased. meal.details and meal.after_details are not loaded.
    """

    meal: Meal
    study_code: str
    participant_code: str
    records: tuple[HeldRecord, ...]
    has_left: bool


def page_of_meals(
    session: Session,
    chosen: RowFilter,
    *,
    after: Key | None,
    limit: int,
    is_newest_first: bool = True,
) -> list[MealRow]:
    """Return at most `limit` meals after `after`, by (captured_at, id)."""
    search = search_of(session, chosen, after=after, is_newest_first=is_newest_first)
    if search is None:
        return []
    keys = keys_of(session, search, after, limit, is_newest_first=is_newest_first)
    return rows_of(session, [meal for _, meal in keys])


def most_doubtful(session: Session, chosen: RowFilter, searched: int, limit: int) -> list[MealRow]:
    """Return the `limit` most doubtful meals of the newest `searched`, by their most doubtful record."""
    search = search_of(session, chosen)
    if search is None:
        return []
    keys = keys_of(session, search, None, searched, is_newest_first=True)
    record = EffectiveRecord
    worst = sa.func.max(record.doubt)
    query = (
        sa.select(record.meal_id)
        .where(record.meal_id.in_([meal for _, meal in keys]), holds(record))
        .group_by(record.meal_id)
        .order_by(worst.desc(), record.meal_id)
        .limit(limit)
    )
    return rows_of(session, list(session.scalars(query)))


def rows_of(session: Session, meal_ids: Sequence[uuid.UUID]) -> list[MealRow]:
    """Return the existing meals of these ids, in their order."""
    if not meal_ids:
        return []
    query = (
        sa.select(Meal, Study.code, Participant.code)
        .join(Study, Study.id == Meal.study_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Meal.id.in_(meal_ids))
        .options(defer(Meal.details, raiseload=True), defer(Meal.after_details, raiseload=True))
    )
    meals = {
        meal.id: (meal, study, participant) for meal, study, participant in session.execute(query)
    }
    held = _held_records(session, meal_ids)
    left = _with_left_photograph(session, meal_ids)
    return [
        MealRow(*meals[meal_id], tuple(held.get(meal_id, ())), has_left=meal_id in left)
        for meal_id in meal_ids
        if meal_id in meals
    ]


def count_by_status(session: Session, study_id: uuid.UUID, most: int) -> dict[str, int]:
    """Return status -> number of the study's meals, counted up to `most`."""
    counts: dict[str, int] = {}
    for status in MEAL_STATUSES:
        of_status = (
            sa.select(Meal.id)
            .where(Meal.study_id == study_id, Meal.status == status)
            .limit(most)
            .subquery()
        )
        counts[status] = session.execute(
            sa.select(sa.func.count()).select_from(of_status)
        ).scalar_one()
    return counts


def count_photographed(session: Session, study_id: uuid.UUID) -> PhotographedMeals:
    """Count a study's photographed meals: those that are measured, and those that wait."""
    is_waiting = Meal.status.in_(("receiving", "queued", "processing"))
    measured_day = sa.case((sa.not_(is_waiting) & (Meal.status != "failed"), Meal.local_date))
    query = sa.select(
        sa.func.count(measured_day),
        sa.func.min(measured_day, type_=sa.Date()),
        sa.func.max(measured_day, type_=sa.Date()),
        sa.func.count(sa.case((is_waiting, Meal.local_date))),
    ).where(Meal.study_id == study_id, Meal.origin == "photographed")
    return PhotographedMeals(*session.execute(query).one())


def changed_meals(
    session: Session, study_id: uuid.UUID, versions: Collection[tuple[uuid.UUID, int]]
) -> list[uuid.UUID]:
    """Return the ids of the study's meals whose version differs from these (client id, version).

    Two participants may have made the same client id: a meal is left out if any version given for its id is its own.
    """
    if not versions:
        return []
    query = sa.select(Meal.id, Meal.client_id, Meal.version).where(
        Meal.client_id.in_({client_id for client_id, _ in versions}), Meal.study_id == study_id
    )
    unchanged = set(versions)
    return sorted(
        meal_id
        for meal_id, client_id, version in session.execute(query)
        if (client_id, version) not in unchanged
    )


def existing_meals(
    session: Session, study_id: uuid.UUID, client_ids: Collection[uuid.UUID]
) -> set[tuple[str, uuid.UUID]]:
    """Return (participant's code, client id) of the study's meals with these client ids."""
    query = (
        sa.select(Participant.code, Meal.client_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Meal.client_id.in_(set(client_ids)), Meal.study_id == study_id)
    )
    return {(code, client_id) for code, client_id in session.execute(query)}


def _held_records(
    session: Session, meal_ids: Sequence[uuid.UUID]
) -> dict[uuid.UUID, list[HeldRecord]]:
    record = EffectiveRecord
    query = (
        sa.select(
            record.meal_id,
            *(record.item_id, record.status, record.provisional, record.reviewed),
            *(Food.key, Food.name),
            *(record.consumed_g, record.energy_kcal, record.doubt, record.flags),
        )
        .join(Item, Item.id == record.item_id)
        .outerjoin(Food, Food.id == record.food_id)
        .where(record.meal_id.in_(meal_ids), holds(record))
        .order_by(record.meal_id, Item.position, Item.id)
    )
    records: dict[uuid.UUID, list[HeldRecord]] = {}
    for meal_id, *values in session.execute(query):
        records.setdefault(meal_id, []).append(HeldRecord(*values))
    return records


def _with_left_photograph(session: Session, meal_ids: Sequence[uuid.UUID]) -> set[uuid.UUID]:
    image = MealImage
    query = sa.select(image.meal_id).where(
        image.meal_id.in_(meal_ids), image.slot == "left", image.erased_at.is_(None)
    )
    return set(session.scalars(query))
