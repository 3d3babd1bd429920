"""What no camera sees, told: answers to a food's probes. Each is an item of its own, or kept so that nobody asks again.

A probe asks for something beside or in a food: fat, sugar, dressing, milk, salt. "drained" asks what the food is: it
makes no item, but may name the food that it is then (the same in syrup, or drained).
"""

from collections.abc import Mapping
from typing import Any

from app.core.errors import ConflictError, InvalidInputError
from app.db.base import Base
from app.foods.models import Food
from app.meals.item_state import ItemState
from app.meals.record_models import Item
from app.records.review.meal_events import Change, Standing
from app.records.review.review_item import food_assignment, named_food
from app.records.review.review_meal import new_item
from app.records.review.told_amounts import DECLARED_SD, told_amount

ABOUT_THE_FOOD = frozenset({"drained"})  # probes whose answer says what the food is, not what came with it


def declare(standing: Standing) -> Change:
    """Answer a probe of an item. Raises InvalidInputError (no probe of its food), ConflictError (answered)."""
    state, told, session = standing.item(), standing.event.told, standing.session
    probe, answer = told["probe"], told["answer"]
    asked = session.get_one(Food, state.food_assignment.food_id).probes if state.food_assignment is not None else []
    if probe not in asked:
        raise InvalidInputError(
            "The item's food does not ask this: `open_probes` of the item names what it asks.",
            code="probe_unknown",
            probes=list(asked),
        )
    if probe in standing.state.answers[state.item.id]:
        raise ConflictError("This was answered: undo the answer to give another.", code="probe_answered")
    new: dict[str, Any] = {"probe": probe, "answer": answer}
    if told["food"] is None:
        if answer == "yes" and probe not in ABOUT_THE_FOOD:
            raise InvalidInputError("Say in `food` what was added, and how much of it.", code="declared_food_missing")
        return Change(new=new)
    food = named_food(session, told["food"])
    if probe in ABOUT_THE_FOOD:
        row = food_assignment(standing, state.item.id, food, None, standing.parts.foods.get(state.item.id, ()))
        return Change(new=new | {"food": food.key}, rows=[row])
    return _added(standing, state, food, new)


def _added(standing: Standing, state: ItemState, food: Food, new: Mapping[str, Any]) -> Change:
    told = standing.event.told
    amount = told_amount(standing.session, told["amount"], food, DECLARED_SD)
    item: Item = new_item(standing, "declared", parent_id=state.item.id)
    rows: list[Base] = [item, food_assignment(standing, item.id, food, None)]
    return Change(new={**new, "food": food.key, "item": str(item.id), "share": told["share"], **amount}, rows=rows)
