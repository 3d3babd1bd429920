"""SQL of identification: the learned index, what a participant has confirmed, and regions without a vector."""

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.stored.identification_models import (
    IndexEntry,
    ItemIdentification,
    TaughtPhotograph,
)
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.outline_json import Ring
from app.meals.stored.record_models import ColourDetails, EffectiveRecord, Item, ItemMeasure, Run
from app.people.models import Study
from app.people.privacy_models import Tombstone

PART = 2000  # entries that are read at once
BEFORE_ALL = -1  # a number before each change of a study

AnyRow = sa.Row[*tuple[Any, ...]]


@dataclass(frozen=True, slots=True)
class EatenRow:
    """A confirmed record of a food. flags: its record's."""

    food_key: str
    captured_at: datetime
    time_zone: str
    flags: tuple[str, ...]


def studies_for(session: Session, study_id: uuid.UUID) -> Iterator[tuple[uuid.UUID, int]]:
    """Yield (study, number of its last change) of those that a study learns from: itself, and those that share."""
    is_one = sa.or_(Study.id == study_id, Study.shares_index)
    for row in session.execute(sa.select(Study.id, Study.change_seq).where(is_one)).all():
        yield row.id, row.change_seq


def changed_entries(
    session: Session, study_id: uuid.UUID, after: int
) -> Iterator[Sequence[AnyRow]]:
    """Yield, in parts, the items whose records changed after this change of the study, with their entries and vectors.

    Vectors are little-endian float16. An item without an entry has none: it lost it, or never had
    one. If `after` is BEFORE_ALL, such items are left out.
    """
    record, entry, seen = EffectiveRecord, IndexEntry, ItemIdentification
    is_of_entry = sa.and_(
        seen.item_id == entry.item_id,
        seen.run_id == entry.run_id,
        seen.vcm_version == entry.vcm_version,
    )
    query = (
        sa.select(
            record.item_id,
            entry.participant_id,
            entry.food_key,
            entry.volume_ml,
            entry.day_minute,
            seen.vcm_version,
            seen.vector,
        )
        .join(entry, entry.item_id == record.item_id, isouter=after > BEFORE_ALL)
        .join(seen, is_of_entry, isouter=after > BEFORE_ALL)
        .where(record.study_id == study_id, record.change_seq > after)
    )
    return session.execute(query, execution_options={"yield_per": PART}).partitions()


def erased_digests(session: Session, study_id: uuid.UUID, after: int) -> set[str]:
    """Return the public digests of what was erased after this change of the study."""
    is_later = Tombstone.study_id == study_id, Tombstone.change_seq > after
    return set(session.scalars(sa.select(Tombstone.digest).where(*is_later)))


def taught_ids(session: Session, study_id: uuid.UUID) -> frozenset[uuid.UUID]:
    """Return the ids of the photographs in force that teach a study."""
    taught = TaughtPhotograph
    query = sa.select(taught.id).where(taught.study_id == study_id)
    return frozenset(session.scalars(query.where(taught.in_force_at.is_not(None))))


def taught_photographs(
    session: Session, study_id: uuid.UUID, food_key: str | None = None
) -> Sequence[TaughtPhotograph]:
    """Return the photographs that teach a study a food, or all, oldest first; drafts, too."""
    taught = TaughtPhotograph
    query = sa.select(taught).where(taught.study_id == study_id)
    if food_key is not None:
        query = query.where(taught.food_key == food_key)
    return session.scalars(query.order_by(taught.created_at)).all()


def eaten_before(
    session: Session, participant_id: uuid.UUID, *, without_meal: uuid.UUID, most: int
) -> list[EatenRow]:
    """Return the participant's newest confirmed foods, also declared ones, except those of one meal."""
    record = EffectiveRecord
    query = (
        sa.select(Food.key, record.captured_at, Meal.time_zone, record.flags)
        .join(Meal, Meal.id == record.meal_id)
        .join(Food, Food.id == record.food_id)
        .where(
            record.participant_id == participant_id,
            record.status.in_(("confirmed", "corrected")),
            record.meal_id != without_meal,
        )
        .order_by(record.captured_at.desc(), record.item_id)
        .limit(most)
    )
    return [
        EatenRow(key, captured_at, zone, tuple(flags))
        for key, captured_at, zone, flags in session.execute(query)
    ]


def entries_of_meal(session: Session, meal_id: uuid.UUID) -> dict[uuid.UUID, IndexEntry]:
    """Return item -> its entry, of one meal."""
    query = (
        sa.select(IndexEntry)
        .join(Item, Item.id == IndexEntry.item_id)
        .where(Item.meal_id == meal_id)
    )
    return {entry.item_id: entry for entry in session.scalars(query)}


DESCRIBED_SLOT = "left"  # outlines are in this photograph's pixels


@dataclass(frozen=True, slots=True)
class SeenRegion:
    """An item's outline (rings, px) as a run saw it.

    colour: by side, the run's colour corrections, if it kept any.
    """

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
