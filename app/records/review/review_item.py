"""What people say of one item: that it is right, that it is no food, what it is, how much, whose share, and where.

Each function is the rule of one kind of event (event_rules.py): it checks the word against the item as it
stands, and returns the old value and the new one with the rows that follow.
"""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError
from app.foods import queries as foods
from app.foods.models import Food
from app.meals import queries as meals
from app.meals.item_state import REMEASURING, ItemState
from app.meals.job_models import Job
from app.meals.record_models import ItemFood
from app.records.item_foods import item_food, served_mass, weighing_for, weighing_of
from app.records.review.meal_events import Change, Standing
from app.records.review.told_amounts import TOLD_SD, told_amount


def confirm(standing: Standing) -> Change:
    """The item is right as it stands. Raises ConflictError where there is nothing to confirm yet."""
    state = standing.item()
    require_complete([state])
    status = "corrected" if state.decision == "corrected" else "confirmed"
    return Change(old={"status": standing.record(state).status}, new={"status": status})


def reject(standing: Standing) -> Change:
    """It is no food, or was not eaten: it counts for nothing. A later word of the same layer brings it back."""
    state = standing.item()
    return Change(old={"status": standing.record(state).status}, new={"status": "rejected"})


def set_food(standing: Standing) -> Change:
    """It is this food, lying so; its volume is weighed anew."""
    state, told = standing.item(), standing.event.told
    food = named_food(standing.session, told["food"])
    row = food_assignment(standing, state.item.id, food, told["lies_as"], standing.parts.foods.get(state.item.id, ()))
    return Change(
        old={"food": key_of(standing.session, state.food_assignment), "lies_as": _lies_as(state)},
        new={"food": food.key, "lies_as": told["lies_as"]},
        rows=[row],
    )


def set_volume(standing: Standing) -> Change:
    """It is so many millilitres; also of a piece that was left."""
    state = standing.item_or_piece()
    return Change(
        old=amount_as_told(state), new=told_amount(standing.session, standing.event.told["amount"], None, TOLD_SD)
    )


def set_mass(standing: Standing) -> Change:
    """It is so many grams, or so many household measures of its food; also of a piece that was left."""
    state = standing.item_or_piece()
    food = standing.session.get_one(Food, state.food_assignment.food_id) if state.food_assignment is not None else None
    new = told_amount(standing.session, standing.event.told["amount"], food, TOLD_SD)
    return Change(old=amount_as_told(state), new=new)


def set_share(standing: Standing) -> Change:
    """The participant ate this part of a dish that was shared."""
    return Change(old={"share": standing.item().share}, new={"share": standing.event.told["share"]})


def redraw(standing: Standing) -> Change:
    """It is what this outline encloses; measured anew."""
    state = standing.item()
    return Change(
        old={"polygon": [list(ring) for ring in state.rings]},
        new={"polygon": standing.event.told["polygon"]},
        rows=[remeasure_job(standing)],
    )


def require_complete(states: Sequence[ItemState]) -> None:
    """Raise ConflictError unless food and amount of each item are known and none is being measured."""
    waiting = [str(state.item.id) for state in states if REMEASURING in state.flags]
    if waiting:
        raise ConflictError(
            "The item is being measured anew: wait until it is (GET the meal with ?wait=).",
            code="item_remeasuring",
            items=waiting,
        )
    unknown = [str(state.item.id) for state in states if not is_complete(state)]
    if unknown:
        raise ConflictError(
            "The food or the amount of an item is not known: set them, or reject the item, before you confirm it.",
            code="item_incomplete",
            items=unknown,
        )


def is_complete(state: ItemState) -> bool:
    """Whether it is known what it is and how much."""
    return (
        state.food_assignment is not None and served_mass(weighing_of(state.food_assignment), state.amount) is not None
    )


def amount_as_told(state: ItemState) -> dict[str, Any]:
    """The amount as it stands, in the words of the API."""
    amount = state.amount
    if amount.mass is not None:
        return {"mass_g": amount.mass.mass_g, "of": amount.mass.of}
    return {"volume_ml": amount.volume_ml}


def remeasure_job(standing: Standing) -> Job:
    """The job that measures the regions of this event. Raises ConflictError where there is nothing to measure in."""
    images = {image.slot: image for image in meals.images_of(standing.session, standing.meal.id)}
    if any(slot not in images or images[slot].erased_at is not None for slot in ("left", "right")):
        raise ConflictError(
            "The meal has no photographs to measure in: tell the amount instead.", code="photographs_missing"
        )
    return Job(
        id=uuid.uuid4(),
        meal_id=standing.meal.id,
        purpose="remeasure",
        event_id=standing.event.id,
        state="queued",
        attempts=0,
        enqueued_at=standing.now,
    )


def _lies_as(state: ItemState) -> str | None:
    return state.food_assignment.lies_as if state.food_assignment is not None else None


def named_food(session: Session, key: str) -> Food:
    """The food of this key in the tables in force. Raises InvalidInputError (`food_unknown`)."""
    found = foods.foods_by_key(session, {key}).get(key)
    if found is None:
        raise InvalidInputError(
            "No food table in force has a food of this key: GET /v1/foods finds those that there are.",
            code="food_unknown",
            food=key,
        )
    return found


def key_of(session: Session, food_assignment: ItemFood | None) -> str | None:
    """The key of the food that an item is taken for."""
    return session.get_one(Food, food_assignment.food_id).key if food_assignment is not None else None


def food_assignment(
    standing: Standing, item_id: uuid.UUID, food: Food, lies_as: str | None, before: Sequence[ItemFood] = ()
) -> ItemFood:
    """The row of an item that is this food from now on, weighed as is known by now. before: its rows so far."""
    return item_food(
        item_id,
        food.id,
        weighing_for(standing.session, food, standing.meal.study_id, lies_as),
        lies_as,
        version=1 + max((row.version for row in before), default=0),
        layer=standing.layer,
        event_id=standing.event.id,
    )


def same_food(standing: Standing, item_id: uuid.UUID, row: ItemFood, *, is_guessed: bool) -> ItemFood:
    """The row of a new item that is the same food as another, weighed the same; what was guessed stays a guess."""
    layer = "automatic" if is_guessed else standing.layer
    return item_food(item_id, row.food_id, weighing_of(row), row.lies_as, layer=layer, event_id=standing.event.id)
