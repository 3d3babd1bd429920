"""SQL of regions that a run saw: which have no vector of a version, and whether their photograph is there."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.identification_models import ItemIdentification
from app.meals.models import Meal, MealImage
from app.meals.record_models import EffectiveRecord, Item, ItemMeasure, Run

DESCRIBED_SLOT = "left"  # outlines are in this photograph's pixels


@dataclass(frozen=True, slots=True)
class SeenRegion:
    """An item's outline (rings, px) as a run saw it. colour: its photographs' corrections, None: it kept none."""

    item_id: uuid.UUID
    run_id: uuid.UUID
    rings: Sequence[object]
    colour: dict[str, object] | None
    marker: str


def meals_to_describe(
    session: Session, vcm_version: str, *, after: uuid.UUID | None, limit: int, study_id: uuid.UUID | None
) -> list[uuid.UUID]:
    """Meals by id, those behind `after`, of which a run saw a region that has no vector of this version."""
    is_found = sa.exists().where(Item.meal_id == Meal.id, _is_bare_item(vcm_version))
    is_measured = sa.exists().where(
        Item.meal_id == Meal.id, ItemMeasure.item_id == Item.id, _is_bare_measure(vcm_version)
    )
    query = sa.select(Meal.id).where(sa.or_(is_found, is_measured)).order_by(Meal.id).limit(limit)
    if after is not None:
        query = query.where(Meal.id > after)
    if study_id is not None:
        query = query.where(Meal.study_id == study_id)
    return list(session.scalars(query))


def regions_to_describe(session: Session, meal_id: uuid.UUID, vcm_version: str) -> list[SeenRegion]:
    """The regions of a meal that a run measured and that have no vector of this version, in the order of items."""
    found = (
        sa.select(Item.id, Run.id.label("run_id"), Item.rings, Run.colour, Run.marker, Item.position)
        .join(Run, Run.id == Item.run_id)
        .where(Item.meal_id == meal_id, _is_bare_item(vcm_version))
    )
    measured = (
        sa.select(Item.id, Run.id.label("run_id"), ItemMeasure.rings, Run.colour, Run.marker, Item.position)
        .join(ItemMeasure, ItemMeasure.item_id == Item.id)
        .join(Run, Run.id == ItemMeasure.run_id)
        .where(Item.meal_id == meal_id, _is_bare_measure(vcm_version))
    )
    rows = sorted([*session.execute(found), *session.execute(measured)], key=lambda row: (row.position, row.id))
    return [SeenRegion(row.id, row.run_id, row.rings, row.colour, row.marker) for row in rows if _is_outline(row.rings)]


def described(session: Session, vcm_version: str, *, study_id: uuid.UUID | None) -> int:
    """How many regions have a vector of this version."""
    query = sa.select(sa.func.count()).select_from(ItemIdentification)
    query = query.where(ItemIdentification.vcm_version == vcm_version)
    if study_id is not None:
        query = query.join(Item, Item.id == ItemIdentification.item_id).join(Meal, Meal.id == Item.meal_id)
        query = query.where(Meal.study_id == study_id)
    return session.scalar(query) or 0


def photograph_of(session: Session, meal_id: uuid.UUID) -> MealImage | None:
    """The photograph that outlines are drawn in, while it is there."""
    query = sa.select(MealImage).where(
        MealImage.meal_id == meal_id, MealImage.slot == DESCRIBED_SLOT, MealImage.erased_at.is_(None)
    )
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def confirmed_without_vector(session: Session, vcm_version: str) -> int:
    """How many confirmed items could teach the index, had they a vector of this version: their photograph is there."""
    has_photograph = sa.exists().where(
        MealImage.meal_id == EffectiveRecord.meal_id,
        MealImage.slot == DESCRIBED_SLOT,
        MealImage.erased_at.is_(None),
    )
    has_vector = sa.exists().where(
        ItemIdentification.item_id == EffectiveRecord.item_id, ItemIdentification.vcm_version == vcm_version
    )
    is_measured = sa.exists().where(ItemMeasure.item_id == EffectiveRecord.item_id)
    query = (
        sa.select(sa.func.count())
        .select_from(EffectiveRecord)
        .where(
            EffectiveRecord.status.in_(("confirmed", "corrected")),
            sa.or_(EffectiveRecord.origin == "pipeline", is_measured),
            has_photograph,
            ~has_vector,
        )
    )
    return session.scalar(query) or 0


def _is_bare_item(vcm_version: str) -> sa.ColumnElement[bool]:
    """Of an item that a run found in the meal's own pair: that run's region has no vector."""
    has_vector = sa.exists().where(
        ItemIdentification.item_id == Item.id,
        ItemIdentification.run_id == Item.run_id,
        ItemIdentification.vcm_version == vcm_version,
    )
    return sa.and_(Item.origin == "pipeline", ~has_vector)


def _is_bare_measure(vcm_version: str) -> sa.ColumnElement[bool]:
    """Of a region that was drawn and measured again: it has no vector. Leftovers are not described."""
    has_vector = sa.exists().where(
        ItemIdentification.item_id == ItemMeasure.item_id,
        ItemIdentification.run_id == ItemMeasure.run_id,
        ItemIdentification.vcm_version == vcm_version,
    )
    return sa.and_(Item.origin != "after", ~has_vector)


def _is_outline(rings: Sequence[Sequence[object]] | None) -> bool:
    """Whether there is a region at all: what could not be measured may have none."""
    return all(len(ring) >= 3 for ring in rings) if rings else False
