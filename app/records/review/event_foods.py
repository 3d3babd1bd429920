"""Foods that events name, and the rows by which an item is taken for them in the layer of the one who says so."""

import uuid
from collections.abc import Sequence

from sqlalchemy.orm import Session

from app.core.errors import InvalidInputError
from app.foods import queries as foods
from app.foods.models import Food
from app.meals.record_models import ItemFood
from app.records.item_foods import item_food, weighing_for, weighing_of
from app.records.review.meal_events import Standing


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


def key_of(session: Session, taken_for: ItemFood | None) -> str | None:
    """The key of the food that an item is taken for."""
    return session.get_one(Food, taken_for.food_id).key if taken_for is not None else None


def taken_for(
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
