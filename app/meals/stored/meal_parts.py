"""Read everything that the records of some meals follow from, in a few queries: items, events, foods, leftovers."""

import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.stored.event_models import MealEvent
from app.meals.stored.identification_models import ItemIdentification
from app.meals.stored.job_models import LIVE_STATES, PAIRS, Job
from app.meals.stored.models import Meal
from app.meals.stored.record_models import (
    EffectiveRecord,
    Item,
    ItemCandidate,
    ItemFood,
    ItemMeasure,
    Leftover,
    Run,
)

FROM_HINT, FROM_INDEX, FROM_MODEL = "hint", "index", "model"  # sources of candidates

Row = TypeVar("Row", ItemFood, ItemMeasure, ItemCandidate)


@dataclass(frozen=True, slots=True)
class Identified:
    """An ItemIdentification without its vector."""

    item_id: uuid.UUID
    run_id: uuid.UUID
    vcm_version: str
    index_version: str | None
    none_probability: float | None
    created_at: datetime


@dataclass(slots=True)
class MealParts:
    """The parts of one meal.

    items: of its newest run, of its newest after-meal run, and those that people made.
    runs: those whose items and measurements count, in their order: the newest of each pair, and if
        that is of a remeasurement, the earlier ones that it measured again
    foods, measures, candidates, identified, leftovers: by item, of all runs
    food_keys: by id of all rows in foods; a key is the same in all versions of a food
    failed_remeasures: events whose regions no run will measure
    waits_for_run: the meal's pair will be measured, for the first time or again
    """

    meal: Meal
    run: Run | None = None
    after_run: Run | None = None
    runs: list[uuid.UUID] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    events: list[MealEvent] = field(default_factory=list)
    foods: dict[uuid.UUID, list[ItemFood]] = field(default_factory=dict)
    food_keys: dict[int, str] = field(default_factory=dict)
    measures: dict[uuid.UUID, list[ItemMeasure]] = field(default_factory=dict)
    candidates: dict[uuid.UUID, list[ItemCandidate]] = field(default_factory=dict)
    identified: dict[uuid.UUID, list[Identified]] = field(default_factory=dict)
    leftovers: dict[uuid.UUID, list[Leftover]] = field(default_factory=dict)
    failed_remeasures: set[uuid.UUID] = field(default_factory=set)
    waits_for_run: bool = False


def parts_of(session: Session, meals: Sequence[Meal]) -> list[MealParts]:
    """Return the parts of each meal, in the order of `meals`."""
    parts = {meal.id: MealParts(meal) for meal in meals}
    ids = list(parts)
    runs: dict[tuple[uuid.UUID, str], list[Run]] = {}
    for run in session.scalars(
        sa.select(Run).where(Run.meal_id.in_(ids)).order_by(Run.created_at, Run.id)
    ):
        if run.purpose in PAIRS:
            runs.setdefault((run.meal_id, run.purpose), []).append(run)
    for (meal_id, purpose), runs_of_pair in runs.items():
        if purpose == "meal":
            parts[meal_id].run = runs_of_pair[-1]
        else:
            parts[meal_id].after_run = runs_of_pair[-1]
        parts[meal_id].runs += [run.id for run in _counting(runs_of_pair)]
    _add_job_states(session, parts)
    by_item = _add_items(session, parts)
    events = sa.select(MealEvent).where(MealEvent.meal_id.in_(ids)).order_by(MealEvent.sequence)
    for event in session.scalars(events):
        parts[event.meal_id].events.append(event)
    if by_item:  # a meal that waits for its estimate, the one that phones poll most, has none
        _add_item_rows(session, by_item)
    return list(parts.values())


def records_of(session: Session, meal_id: uuid.UUID) -> dict[uuid.UUID, EffectiveRecord]:
    """Return item -> effective record, of one meal."""
    query = sa.select(EffectiveRecord).where(EffectiveRecord.meal_id == meal_id)
    return {record.item_id: record for record in session.scalars(query)}


def candidates_of_items(
    session: Session, item_ids: Collection[uuid.UUID]
) -> tuple[dict[uuid.UUID, list[ItemCandidate]], dict[uuid.UUID, list[Identified]]]:
    """Return item -> its candidates of all runs, and item -> its identifications, the newest last."""
    candidates: dict[uuid.UUID, list[ItemCandidate]] = {}
    for row in _of_items(session, ItemCandidate, item_ids):
        candidates.setdefault(row.item_id, []).append(row)
    seen = ItemIdentification
    query = (
        sa.select(
            seen.item_id,
            seen.run_id,
            seen.vcm_version,
            seen.index_version,
            seen.none_probability,
            seen.created_at,
        )
        .where(seen.item_id.in_(list(item_ids)))
        .order_by(seen.item_id, seen.created_at, seen.vcm_version)
    )
    identified: dict[uuid.UUID, list[Identified]] = {}
    for each in session.execute(query):
        identified.setdefault(each.item_id, []).append(Identified(*each))
    return candidates, identified


def meals_after(
    session: Session,
    after: uuid.UUID | None,
    limit: int,
    *,
    lock: bool,
    study_id: uuid.UUID | None = None,
) -> list[Meal]:
    """Return meals ordered by id, after the id `after`.

    lock: lock them against new events and runs.
    """
    query = sa.select(Meal).order_by(Meal.id).limit(limit)
    if lock:
        query = query.with_for_update()
    if after is not None:
        query = query.where(Meal.id > after)
    if study_id is not None:
        query = query.where(Meal.study_id == study_id)
    return list(session.scalars(query))


def _counting(runs: Sequence[Run]) -> Sequence[Run]:
    """Return a pair's last run of its own job, and the remeasurements after it.

    runs: of one pair, oldest first.
    """
    first = max(
        (place for place, run in enumerate(runs) if run.remeasurement_id is None), default=0
    )
    return runs[first:]


def _add_job_states(session: Session, parts: Mapping[uuid.UUID, MealParts]) -> None:
    has_failed = sa.and_(Job.purpose == "remeasure", Job.state == "failed")
    # in the transaction that saves its run it is not yet done
    has_no_run = ~sa.exists().where(Run.id == Job.id)
    is_to_come = sa.and_(Job.purpose == "meal", Job.state.in_(LIVE_STATES), has_no_run)
    for job in session.scalars(
        sa.select(Job).where(Job.meal_id.in_(list(parts)), sa.or_(has_failed, is_to_come))
    ):
        if job.purpose == "meal":
            parts[job.meal_id].waits_for_run = True
        elif job.event_id is not None:
            parts[job.meal_id].failed_remeasures.add(job.event_id)


def _add_items(
    session: Session, parts: Mapping[uuid.UUID, MealParts]
) -> dict[uuid.UUID, MealParts]:
    """Add items to each meal, except those of runs that do not count.

    Returns item -> its meal's parts.
    """
    by_item = {}
    query = sa.select(Item).where(Item.meal_id.in_(list(parts))).order_by(Item.position, Item.id)
    for item in session.scalars(query):
        meal_parts = parts[item.meal_id]
        if item.run_id is None or item.run_id in meal_parts.runs:
            meal_parts.items.append(item)
            by_item[item.id] = meal_parts
    return by_item


def _add_item_rows(session: Session, by_item: Mapping[uuid.UUID, MealParts]) -> None:
    assignments = _of_items(session, ItemFood, by_item)
    keys = _keys_of(session, {row.food_id for row in assignments})
    for row in assignments:
        by_item[row.item_id].foods.setdefault(row.item_id, []).append(row)
        by_item[row.item_id].food_keys[row.food_id] = keys[row.food_id]
    for measure in _of_items(session, ItemMeasure, by_item):
        by_item[measure.item_id].measures.setdefault(measure.item_id, []).append(measure)
    candidates, identified = candidates_of_items(session, by_item)
    for item_id, parts in by_item.items():
        parts.candidates[item_id] = candidates.get(item_id, [])
        parts.identified[item_id] = identified.get(item_id, [])
    after = (
        sa.select(Leftover)
        .where(Leftover.after_item_id.in_(list(by_item)))
        .order_by(Leftover.version)
    )
    for leftover in session.scalars(after):
        by_item[leftover.after_item_id].leftovers.setdefault(leftover.after_item_id, []).append(
            leftover
        )


def _keys_of(session: Session, food_ids: Collection[int]) -> dict[int, str]:
    if not food_ids:
        return {}
    keys: dict[int, str] = dict(
        session.execute(sa.select(Food.id, Food.key).where(Food.id.in_(food_ids))).all()
    )
    return keys


def _of_items(session: Session, table: type[Row], items: Collection[uuid.UUID]) -> list[Row]:
    """Return the items' rows of a table, in the order of their keys."""
    order = list(sa.inspect(table).primary_key)
    return list(
        session.scalars(sa.select(table).where(table.item_id.in_(list(items))).order_by(*order))
    )
