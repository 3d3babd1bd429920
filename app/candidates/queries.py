"""SQL of the learned index: entries with their vectors, and foods that a participant has confirmed."""

import uuid
from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.stored.identification_models import IndexEntry, ItemIdentification
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.models import Study


@dataclass(frozen=True, slots=True)
class Entry:
    """A confirmed item. is_own: of the meal's study, not of one that shares its index. day_minute: local."""

    item_id: uuid.UUID
    run_id: uuid.UUID
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
    vcm_version: str,
    *,
    without_meal: uuid.UUID,
    most: int,
    most_recent: int,
) -> list[Entry]:
    """Return the entries that a study learns from, the newest last: its own, and those of studies that share.

    At most `most`, divided evenly among the foods. Within a food the study's own entries come first, and eaters take
    turns, each with the newest entry first, so that no single eater represents a food. If that limit is reached, the
    newest `most_recent` entries of the study are added, which show how often a food is eaten.
    """
    is_own = IndexEntry.study_id == study_id
    newest = (IndexEntry.captured_at.desc(), IndexEntry.item_id)
    eater = (IndexEntry.food_key, IndexEntry.participant_id)
    chosen = sa.select(
        IndexEntry.item_id,
        IndexEntry.run_id,
        IndexEntry.participant_id,
        IndexEntry.food_key,
        IndexEntry.volume_ml,
        IndexEntry.captured_at,
        IndexEntry.day_minute,
        is_own.label("is_own"),
    ).where(
        IndexEntry.vcm_version == vcm_version,
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
    session: Session, entries: Collection[Entry], vcm_version: str
) -> dict[tuple[uuid.UUID, uuid.UUID], bytes]:
    """Return (item, run) -> vector, little-endian float16, of these entries."""
    if not entries:
        return {}
    keys = {(entry.item_id, entry.run_id) for entry in entries}
    seen = ItemIdentification
    query = sa.select(seen.item_id, seen.run_id, seen.vector).where(
        seen.item_id.in_([item_id for item_id, _ in keys]), seen.vcm_version == vcm_version
    )
    return {
        (row.item_id, row.run_id): row.vector
        for row in session.execute(query)
        if (row[0], row[1]) in keys
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
