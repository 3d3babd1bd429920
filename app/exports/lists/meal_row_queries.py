"""What a list of meals shows of each: the meal, the records that hold, its left photograph; a handful of statements.

Also how many meals of a study have each status, counted up to a bound, and which of some meals have changed, or are
there at all.
"""

import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session, defer

from app.exports.lists.meal_page_queries import keys_of, search_of
from app.foods.models import Food
from app.http.row_filter import RowFilter
from app.meals.models import MEAL_STATUSES, Meal, MealImage
from app.meals.record_models import EffectiveRecord, Item
from app.people.models import Participant, Study
from app.records.conditions import holds
from app.records.page_queries import Key


class HeldRecord(NamedTuple):
    """A record that holds (not rejected), as far as a list of meals needs it; food_name: in the version that it has."""

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


@dataclass(frozen=True, slots=True)
class MealRow:
    """A meal of a list. records: those that hold, in the order of the items.

    has_left: its left photograph has come and is not erased. meal.details and meal.after_details are not read.
    """

    meal: Meal
    study_code: str
    participant_code: str
    records: tuple[HeldRecord, ...]
    has_left: bool


def page_of_meals(
    session: Session, chosen: RowFilter, *, after: Key | None, limit: int, is_newest_first: bool = True
) -> list[MealRow]:
    """At most `limit` meals by (captured_at, id), those behind `after`."""
    search = search_of(session, chosen, after=after, is_newest_first=is_newest_first)
    if search is None:
        return []
    keys = keys_of(session, search, after, limit, is_newest_first=is_newest_first)
    return rows_of(session, [meal for _, meal in keys])


def rows_of(session: Session, meal_ids: Sequence[uuid.UUID]) -> list[MealRow]:
    """These meals in the order given; one that is not there is left out."""
    if not meal_ids:
        return []
    query = (
        sa.select(Meal, Study.code, Participant.code)
        .join(Study, Study.id == Meal.study_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Meal.id.in_(meal_ids))
        .options(defer(Meal.details, raiseload=True), defer(Meal.after_details, raiseload=True))
    )
    found = {meal.id: (meal, study, person) for meal, study, person in session.execute(query)}
    held = _held_records(session, meal_ids)
    left = _with_left_photograph(session, meal_ids)
    return [
        MealRow(*found[meal_id], tuple(held.get(meal_id, ())), has_left=meal_id in left)
        for meal_id in meal_ids
        if meal_id in found
    ]


def count_by_status(session: Session, study_id: uuid.UUID, most: int) -> dict[str, int]:
    """Status -> how many meals of the study have it, counted up to `most`."""
    counts: dict[str, int] = {}
    for status in MEAL_STATUSES:
        of_status = sa.select(Meal.id).where(Meal.study_id == study_id, Meal.status == status).limit(most).subquery()
        counts[status] = session.execute(sa.select(sa.func.count()).select_from(of_status)).scalar_one()
    return counts


def changed_meals(session: Session, study_id: uuid.UUID, known: Collection[tuple[uuid.UUID, int]]) -> list[uuid.UUID]:
    """Of the study's meals of these (client id, version) the ids of those whose version is another now.

    Two participants may have made the same client id: a meal is left out where any version told of its id is its own.
    """
    if not known:
        return []
    query = sa.select(Meal.id, Meal.client_id, Meal.version).where(
        Meal.client_id.in_({client_id for client_id, _ in known}), Meal.study_id == study_id
    )
    told = set(known)
    return sorted(meal_id for meal_id, client_id, version in session.execute(query) if (client_id, version) not in told)


def meals_there(session: Session, study_id: uuid.UUID, client_ids: Collection[uuid.UUID]) -> set[tuple[str, uuid.UUID]]:
    """The study's meals of these client ids: participant's code, client id."""
    query = (
        sa.select(Participant.code, Meal.client_id)
        .join(Participant, Participant.id == Meal.participant_id)
        .where(Meal.client_id.in_(set(client_ids)), Meal.study_id == study_id)
    )
    return {(code, client_id) for code, client_id in session.execute(query)}


def _held_records(session: Session, meal_ids: Sequence[uuid.UUID]) -> dict[uuid.UUID, list[HeldRecord]]:
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
    found: dict[uuid.UUID, list[HeldRecord]] = {}
    for meal_id, *values in session.execute(query):
        found.setdefault(meal_id, []).append(HeldRecord(*values))
    return found


def _with_left_photograph(session: Session, meal_ids: Sequence[uuid.UUID]) -> set[uuid.UUID]:
    image = MealImage
    query = sa.select(image.meal_id).where(image.meal_id.in_(meal_ids), image.slot == "left", image.erased_at.is_(None))
    return set(session.scalars(query))
