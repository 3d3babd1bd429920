"""SQL of identification: the learned index, what a participant has confirmed, and regions without a vector."""

import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.stored.identification_models import IndexEntry, ItemIdentification
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.outline_json import Ring
from app.meals.stored.record_models import ColourDetails, EffectiveRecord, Item, ItemMeasure, Run
from app.people.models import Study


@dataclass(frozen=True, slots=True)
class Entry:
    """A confirmed item.

    vcm_version: of its vector
    is_own: of the meal's study, not of one that shares its index
    day_minute: local
    """

    item_id: uuid.UUID
    run_id: uuid.UUID
    vcm_version: str
    participant_id: uuid.UUID
    food_key: str
    volume_ml: float | None
    captured_at: datetime
    day_minute: int
    is_own: bool


@dataclass(frozen=True, slots=True)
class EatenRow:
    """A confirmed record of a food. flags: its record's."""

    food_key: str
    captured_at: datetime
    time_zone: str
    flags: tuple[str, ...]


def entries_for(
    session: Session,
    study_id: uuid.UUID,
    vcm_versions: Collection[str],
    *,
    without_meal: uuid.UUID,
    most: int,
    most_recent: int,
) -> list[Entry]:
    """Return the entries that a study learns from, the newest last: its own, and those of studies that share.

    At most `most`, divided evenly among the foods. Within a food the study's own entries come
    first, and eaters take turns, each with the newest entry first, so that no single eater
    represents a food. If that limit is reached, the newest `most_recent` entries of the study are
    added, which show how often a food is eaten.
    """
    is_own = IndexEntry.study_id == study_id
    newest = (IndexEntry.captured_at.desc(), IndexEntry.item_id)
    eater = (IndexEntry.food_key, IndexEntry.participant_id)
    chosen = sa.select(
        IndexEntry.item_id,
        IndexEntry.run_id,
        IndexEntry.vcm_version,
        IndexEntry.participant_id,
        IndexEntry.food_key,
        IndexEntry.volume_ml,
        IndexEntry.captured_at,
        IndexEntry.day_minute,
        is_own.label("is_own"),
    ).where(
        IndexEntry.vcm_version.in_(vcm_versions),
        sa.or_(is_own, IndexEntry.study_id.in_(sa.select(Study.id).where(Study.shares_index))),
        IndexEntry.item_id.not_in(sa.select(Item.id).where(Item.meal_id == without_meal)),
    )
    turn = sa.func.row_number().over(partition_by=eater, order_by=newest).label("turn")
    turns = chosen.add_columns(turn).subquery()
    best = (turns.c.is_own.desc(), turns.c.turn, turns.c.captured_at.desc(), turns.c.item_id)
    place = sa.func.row_number().over(partition_by=turns.c.food_key, order_by=best).label("place")
    ranked = sa.select(turns, place).subquery()
    order = (ranked.c.place, ranked.c.is_own.desc(), ranked.c.captured_at.desc(), ranked.c.item_id)
    columns = [column for column in ranked.c if column.name not in {"turn", "place"}]
    entries = {
        Entry(**row)
        for row in session.execute(sa.select(*columns).order_by(*order).limit(most)).mappings()
    }
    if len(entries) == most:
        recent = chosen.where(is_own).order_by(*newest).limit(most_recent)
        entries |= {Entry(**row) for row in session.execute(recent).mappings()}
    return sorted(entries, key=lambda entry: (entry.captured_at, entry.item_id))


def vectors_of(
    session: Session, entries: Collection[Entry]
) -> dict[tuple[uuid.UUID, uuid.UUID, str], bytes]:
    """Return (item, run, version) -> vector, little-endian float16, of these entries."""
    if not entries:
        return {}
    keys = {(entry.item_id, entry.run_id, entry.vcm_version) for entry in entries}
    seen = ItemIdentification
    query = sa.select(seen.item_id, seen.run_id, seen.vcm_version, seen.vector).where(
        seen.item_id.in_([entry.item_id for entry in entries])
    )
    return {
        (row.item_id, row.run_id, row.vcm_version): row.vector
        for row in session.execute(query)
        if (row[0], row[1], row[2]) in keys
    }


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
