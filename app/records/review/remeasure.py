"""Measure regions that a person drew: the hints of an event's job for the pipeline, and how its answer is stored.

The pipeline gets all current foods of the meal, so that neighbours keep their own pixels; only the
regions that the event drew are measured. Amounts that a person stated since, and the meal's own
run, do not change.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from app.candidates.item_candidates import save_candidates
from app.foods.models import Food
from app.meals.stored.event_models import MealEvent
from app.meals.stored.event_values import Region
from app.meals.stored.item_state import (
    NOT_MEASURABLE,
    ItemState,
    StatedEvent,
    drawn_region,
    fold_meal,
    read_event,
    stated_form,
)
from app.meals.stored.job_models import Job
from app.meals.stored.meal_parts import MealParts, parts_of
from app.meals.stored.models import Meal
from app.meals.stored.outline_json import rings_of
from app.meals.stored.record_models import Item, ItemMeasure
from app.meals.stored.run_answer import ItemAnswer, RunAnswer
from app.records.item_foods import item_food, weighing_for

MAX_REGIONS = 40  # hints of one run
MIN_CORNERS = 3  # of a ring that encloses something
FAILED = "remeasure_failed"

Hint = Mapping[str, Any]  # as the phone sends it


@dataclass(frozen=True, slots=True)
class Regions:
    """hints: as the phone sends them, one per region; items: the item of each region."""

    hints: tuple[Hint, ...]
    items: tuple[uuid.UUID, ...]


def regions_to_measure(session: Session, job: Job, meal: Meal) -> Regions:
    """Return the hints for the job's event: the regions that it drew, and the other current foods."""
    stated = read_event(session.get_one(MealEvent, job.event_id))
    states = {state.item.id: state for state in fold_meal(parts_of(session, [meal])[0]).items}
    drawn = {item.id: drawn_region(stated, item) for item in _concerned(session, stated.event)}
    hints, items = [], []
    for item_id, region_of_item in drawn.items():
        if region_of_item is not None:
            hints.append(_with_food(session, region_of_item, states[item_id]))
            items.append(item_id)
    for item_id, state in states.items():
        outline = [ring for ring in state.rings if len(ring) >= MIN_CORNERS]
        if (
            item_id not in drawn
            and state.is_live
            and state.stands
            and outline
            and len(hints) < MAX_REGIONS
        ):
            region = Region(polygon=[[list(corner) for corner in ring] for ring in outline])
            hints.append(_with_food(session, region, state))
            items.append(item_id)
    return Regions(tuple(hints), tuple(items))


def save_measures(session: Session, job: Job, meal: Meal, answer: RunAnswer) -> None:
    """Store the measurements of the regions that the job's event drew; an item that was not found is flagged.

    An item without a stated food is assigned to the one that the index identifies in its new
    region, if it is sure.
    """
    stated = read_event(session.get_one(MealEvent, job.event_id))
    measured = {
        answer.regions[item.hint]: item
        for item in answer.items
        if item.hint is not None and item.polygon
    }
    drawn = [
        item for item in _concerned(session, stated.event) if drawn_region(stated, item) is not None
    ]
    session.add_all(
        _measure(item, stated, job.id, measured.get(item.id), has_failed=answer.failure is not None)
        for item in drawn
    )
    seen = [(item, measured[item.id]) for item in drawn if item.id in measured]
    likely = save_candidates(session, job.id, seen)
    parts = parts_of(session, [meal])[0]
    states = {state.item.id: state for state in fold_meal(parts).items}
    for (item, _), food in zip(seen, likely, strict=True):
        state = states.get(item.id)
        if (
            food is None
            or state is None
            or state.run_id != job.id
            or not _is_open(parts, state, food)
        ):
            continue  # not sure, or a newer region or a person's statement counts
        lies_as = stated_form(stated, item) or (
            state.food_assignment.lies_as if state.food_assignment is not None else None
        )
        before = max((row.version for row in parts.foods.get(item.id, ())), default=0)
        session.add(
            item_food(
                item.id,
                food.id,
                weighing_for(session, food, meal.study_id, lies_as),
                lies_as,
                version=before + 1,
                event_id=stated.event.id,
            )
        )


def _is_open(parts: MealParts, state: ItemState, food: Food) -> bool:
    """Whether the server may assign this food: the item has none, or another that the server guessed."""
    row = state.food_assignment
    return row is None or (state.is_food_guessed and parts.food_keys[row.food_id] != food.key)


def _concerned(session: Session, event: MealEvent) -> list[Item]:
    """Return the items that the event is about or created."""
    made = list(
        session.query(Item).where(Item.event_id == event.id).order_by(Item.position, Item.id)
    )
    own = (
        session.get(Item, event.item_id)
        if event.kind == "redraw" and event.item_id is not None
        else None
    )
    return [own] if own is not None else made


def _measure(
    item: Item,
    stated: StatedEvent,
    run_id: uuid.UUID,
    answer: ItemAnswer | None,
    *,
    has_failed: bool,
) -> ItemMeasure:
    region = drawn_region(stated, item)
    if answer is None:
        polygon = region.polygon if region is not None else None
        return ItemMeasure(
            item_id=item.id,
            event_id=stated.event.id,
            run_id=run_id,
            rings=rings_of(polygon) if polygon is not None else [],
            volume_ml=None,
            volume_low_ml=None,
            volume_high_ml=None,
            relative_sd={},
            flags=[FAILED if has_failed else NOT_MEASURABLE],
        )
    return measure_of(item, run_id, answer, event_id=stated.event.id)


def measure_of(
    item: Item, run_id: uuid.UUID, answer: ItemAnswer, *, event_id: uuid.UUID | None = None
) -> ItemMeasure:
    """Return the row of a run's measurement of an item.

    event_id: of the event that drew the region; None: of none
    """
    return ItemMeasure(item_id=item.id, event_id=event_id, run_id=run_id, **answer.columns())


def _with_food(session: Session, region: Region, state: ItemState) -> Hint:
    row, hint = state.food_assignment, region.model_dump(exclude_none=True)
    if row is None:
        return hint
    named = {"food": session.get_one(Food, row.food_id).key}
    return hint | named | ({"lies_as": row.lies_as} if row.lies_as is not None else {})
