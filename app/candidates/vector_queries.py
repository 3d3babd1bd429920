"""SQL of regions that a run saw: those without a vector of a version, and their photographs."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.meals.stored.identification_models import ItemIdentification
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.outline_json import Ring
from app.meals.stored.record_models import ColourDetails, EffectiveRecord, Item, ItemMeasure, Run

DESCRIBED_SLOT = "left"  # outlines are in this photograph's pixels


@dataclass(frozen=True, slots=True)
class SeenRegion:
    """An item's outline (rings, px) as a run saw it. colour: by side, the run's colour corrections, if it kept any."""

    item_id: uuid.UUID
    run_id: uuid.UUID
    rings: list[Ring]
    colour: dict[str, ColourDetails] | None
    marker: str | None


def meals_to_describe(
    session: Session,
    vcm_version: str,
    *,
    after: uuid.UUID | None,
    limit: int,
    study_id: uuid.UUID | None,
) -> list[uuid.UUID]:
    """Return meals with a region that lacks a vector of this version, ordered by id, after the id `after`."""
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
    """Return the meal's measured regions that lack a vector of this version, in the order of items."""
    found = (
        sa.select(
            Item.id, Run.id.label("run_id"), Item.rings, Run.colour, Run.marker, Item.position
        )
        .join(Run, Run.id == Item.run_id)
        .where(Item.meal_id == meal_id, _is_bare_item(vcm_version))
    )
    measured = (
        sa.select(
            Item.id,
            Run.id.label("run_id"),
            ItemMeasure.rings,
            Run.colour,
            Run.marker,
            Item.position,
        )
        .join(ItemMeasure, ItemMeasure.item_id == Item.id)
        .join(Run, Run.id == ItemMeasure.run_id)
        .where(Item.meal_id == meal_id, _is_bare_measure(vcm_version))
    )
    rows = sorted(
        [*session.execute(found), *session.execute(measured)],
        key=lambda row: (row.position, row.id),
    )
    return [
        SeenRegion(row.id, row.run_id, row.rings, row.colour, row.marker)
        for row in rows
        if _is_outline(row.rings)
    ]


def described(session: Session, vcm_version: str, *, study_id: uuid.UUID | None) -> int:
    """Return the number of regions with a vector of this version."""
    query = sa.select(sa.func.count()).select_from(ItemIdentification)
    query = query.where(ItemIdentification.vcm_version == vcm_version)
    if study_id is not None:
        query = query.join(Item, Item.id == ItemIdentification.item_id).join(
            Meal, Meal.id == Item.meal_id
        )
        query = query.where(Meal.study_id == study_id)
    return session.scalar(query) or 0


def photograph_of(session: Session, meal_id: uuid.UUID) -> MealImage | None:
    """Return the photograph that outlines are drawn in; None if it is erased or missing."""
    query = sa.select(MealImage).where(
        MealImage.meal_id == meal_id,
        MealImage.slot == DESCRIBED_SLOT,
        MealImage.erased_at.is_(None),
    )
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()


def confirmed_without_vector(session: Session, vcm_version: str) -> int:
    """Return the number of confirmed items that have a photograph, but no vector of this version yet."""
    has_photograph = sa.exists().where(
        MealImage.meal_id == EffectiveRecord.meal_id,
        MealImage.slot == DESCRIBED_SLOT,
        MealImage.erased_at.is_(None),
    )
    has_vector = sa.exists().where(
        ItemIdentification.item_id == EffectiveRecord.item_id,
        ItemIdentification.vcm_version == vcm_version,
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
    """Whether an item of the meal's own pair lacks a vector of its run's region."""
    has_vector = sa.exists().where(
        ItemIdentification.item_id == Item.id,
        ItemIdentification.run_id == Item.run_id,
        ItemIdentification.vcm_version == vcm_version,
    )
    return sa.and_(Item.origin == "pipeline", ~has_vector)


def _is_bare_measure(vcm_version: str) -> sa.ColumnElement[bool]:
    """Whether a redrawn region lacks a vector. Leftovers are not described."""
    has_vector = sa.exists().where(
        ItemIdentification.item_id == ItemMeasure.item_id,
        ItemIdentification.run_id == ItemMeasure.run_id,
        ItemIdentification.vcm_version == vcm_version,
    )
    return sa.and_(Item.origin != "after", ~has_vector)


def _is_outline(rings: Sequence[Sequence[object]] | None) -> bool:
    """Whether there is a region: an item that could not be measured may have none."""
    return all(len(ring) >= 3 for ring in rings) if rings else False
