"""What the rules of all kinds of events share: the meal before the event, the change that a rule returns, its rows.

Amounts that people state are grams, millilitres or household measures, each with its uncertainty.
The relative standard deviations apply where the sender states none. A kitchen scale is better,
memory is worse; an app that knows sends its own.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal, TypedDict

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.db.base import Base
from app.foods import queries as foods
from app.foods.models import Food
from app.foods.packaged.packaged_foods import adopt
from app.meals.stored import queries as meals
from app.meals.stored.event_models import Layer
from app.meals.stored.event_values import Region
from app.meals.stored.item_state import REMEASURING, UNKNOWN_AMOUNT, Amount, ItemState, MealState
from app.meals.stored.job_models import Job
from app.meals.stored.meal_parts import MealParts
from app.meals.stored.models import Meal
from app.meals.stored.outline_json import Ring, rings_of
from app.meals.stored.record_models import EffectiveRecord, Item, ItemFood
from app.records.item_foods import item_food, served_mass, weighing_for, weighing_of
from app.records.review.schemas import AmountIn, PartIn, RegionIn

STATED_SD = 0.1  # grams or millilitres set while looking at the food
PORTION_SD = 0.2  # a household measure: level or heaped
DECLARED_SD = 0.25  # stated from memory


class StatedAmount(TypedDict, total=False):
    """An amount as an event stores it: mass_g and of, or volume_ml, with relative_sd; empty: none was stated.

    portion_of: key of the food whose household measure was stated; the grams hold for no other
    food.
    """

    mass_g: float
    of: Literal["as_seen", "edible"]
    volume_ml: float | None
    relative_sd: float
    portion: str
    count: float
    portion_of: str


def stated_amount(
    session: Session, amount: AmountIn | None, food: Food | None, default_sd: float
) -> StatedAmount:
    """Convert an amount of the API to its stored form.

    food: the food whose household measures apply.

    Raises InvalidInputError (`portion_unknown`) if the food has no household measure of that name.
    """
    if amount is None:
        return {}
    sd = default_sd if amount.relative_sd is None else amount.relative_sd
    if amount.portion is not None and amount.count is not None:
        portion_g, food_key = _portion(session, food, amount.portion)
        return {
            "mass_g": portion_g * amount.count,
            "of": "edible",
            "relative_sd": max(default_sd, PORTION_SD) if amount.relative_sd is None else sd,
            "portion": amount.portion,
            "count": amount.count,
            "portion_of": food_key,
        }
    if amount.mass_g is not None:
        return {"mass_g": amount.mass_g, "of": amount.of or "as_seen", "relative_sd": sd}
    return {"volume_ml": amount.volume_ml, "relative_sd": sd}


def _portion(session: Session, food: Food | None, measure: str) -> tuple[float, str]:
    """Return the edible grams of one such measure of the food, and the food's key."""
    portions = foods.portions_of(session, food.id) if food is not None else []
    for portion in portions:
        if food is not None and portion.measure == measure:
            return portion.mass_g / portion.amount, food.key
    raise InvalidInputError(
        "The food has no such household measure: send one of `portions` of GET /v1/foods/{key}, or grams.",
        code="portion_unknown",
        portions=[portion.measure for portion in portions],
    )


# random namespace of the ids of created items
ITEMS_OF_EVENT = uuid.UUID("b1c4b7a3-8a0f-4f27-8d9d-2d9a4b2f60c5")


@dataclass(frozen=True, slots=True)
class ReviewContext:
    """The meal before an event. layer: of the event's author; now: when the event arrived."""

    session: Session
    meal: Meal
    parts: MealParts
    state: MealState
    event_id: uuid.UUID
    layer: Layer
    now: datetime

    def item(self, item_id: uuid.UUID) -> ItemState:
        """Return an item that can still be reviewed.

        Raises NotFoundError if the meal has no such item, ConflictError if it was replaced or
        undone.
        """
        for state in self.state.items:
            if state.item.id == item_id:
                if not state.stands:
                    raise ConflictError(
                        "This item was split, merged or undone since: GET the meal to see what stands in its place.",
                        code="item_replaced",
                        item=str(item_id),
                    )
                return state
        raise NotFoundError("This meal has no such item.", code="item_not_found")

    def item_or_piece(self, item_id: uuid.UUID) -> ItemState:
        """Return an item of the meal, or a piece of its after-meal pair. Raises as `item`."""
        pieces = (piece.state for piece in self.state.leftovers)
        return next((piece for piece in pieces if piece.item.id == item_id), None) or self.item(
            item_id
        )

    def record(self, state: ItemState) -> EffectiveRecord:
        """Return the item's current effective record."""
        return self.session.get_one(EffectiveRecord, state.item.id)


@dataclass(frozen=True, slots=True)
class Change:
    """What an event changes: its new and old values in the fields of the API, and the rows that it creates.

    rows: inserted after the event in this order; a Job among them is queued.
    """

    new: Mapping[str, object] = field(default_factory=dict)
    old: Mapping[str, object] = field(default_factory=dict)
    rows: Sequence[Base] = ()


def require_complete(states: Sequence[ItemState]) -> None:
    """Raise ConflictError unless food and amount of each item are known and none is being measured."""
    remeasuring = [str(state.item.id) for state in states if REMEASURING in state.flags]
    if remeasuring:
        raise ConflictError(
            "The item is being measured again: wait until it is done (GET the meal with ?wait=).",
            code="item_remeasuring",
            items=remeasuring,
        )
    incomplete = [str(state.item.id) for state in states if not _is_complete(state)]
    if incomplete:
        raise ConflictError(
            "The food or the amount of an item is not known: set them, or reject the item, before you confirm it.",
            code="item_incomplete",
            items=incomplete,
        )


def _is_complete(state: ItemState) -> bool:
    return (
        state.food_assignment is not None
        and served_mass(weighing_of(state.food_assignment), state.amount) is not None
    )


def new_item(
    context: ReviewContext,
    origin: str,
    *,
    place: int = 0,
    rings: Sequence[Ring] = (),
    amount: Amount = UNKNOWN_AMOUNT,
    parent_id: uuid.UUID | None = None,
) -> Item:
    """Return an item that the event creates. place: its number among them; amount: its volume."""
    return Item(
        id=uuid.uuid5(ITEMS_OF_EVENT, f"{context.event_id}/{place}"),
        meal_id=context.meal.id,
        origin=origin,
        parent_id=parent_id,
        event_id=context.event_id,
        position=1 + max((item.position for item in context.parts.items), default=-1) + place,
        rings=list(rings),
        flags=[],
        volume_ml=amount.volume_ml,
        volume_low_ml=amount.volume_low_ml,
        volume_high_ml=amount.volume_high_ml,
        relative_sd=dict(amount.relative_sd),
    )


def drawn_rings(region: RegionIn | PartIn) -> list[Ring]:
    """Return the rings of a drawn outline; none if it has no outline."""
    drawn = Region.model_validate(region.model_dump(include={"polygon"}))
    return rings_of(drawn.polygon) if drawn.polygon is not None else []


def named_food(session: Session, key: str) -> Food:
    """Return the food with this key in the tables in force; a packaged food becomes one.

    Raises InvalidInputError (`food_unknown`).
    """
    food = foods.foods_by_key(session, {key}).get(key) or adopt(session, key)
    if food is None:
        raise InvalidInputError(
            "No food table in force has a food with this key: GET /v1/foods lists those that exist.",
            code="food_unknown",
            food=key,
        )
    return food


def food_key(session: Session, assignment: ItemFood | None) -> str | None:
    """Return the key of the food that an item is assigned to."""
    return session.get_one(Food, assignment.food_id).key if assignment is not None else None


def assign_food(
    context: ReviewContext,
    item_id: uuid.UUID,
    food: Food,
    lies_as: str | None,
    earlier: Sequence[ItemFood] = (),
) -> ItemFood:
    """Return the row that assigns an item to a food, with current densities.

    earlier: the item's rows so far.
    """
    return item_food(
        item_id,
        food.id,
        weighing_for(context.session, food, context.meal.study_id, lies_as),
        lies_as,
        version=1 + max((row.version for row in earlier), default=0),
        layer=context.layer,
        event_id=context.event_id,
    )


def copy_food(
    context: ReviewContext, item_id: uuid.UUID, assignment: ItemFood, *, is_guessed: bool
) -> ItemFood:
    """Return the row that assigns a new item to another item's food and density; a guess stays a guess."""
    layer = "automatic" if is_guessed else context.layer
    weighing = weighing_of(assignment)
    return item_food(
        item_id,
        assignment.food_id,
        weighing,
        assignment.lies_as,
        layer=layer,
        event_id=context.event_id,
    )


def remeasure_job(context: ReviewContext) -> Job:
    """Return the job that measures the event's regions.

    Raises ConflictError if a photograph is missing.
    """
    images = {image.slot: image for image in meals.images_of(context.session, context.meal.id)}
    if any(
        slot not in images or images[slot].erased_at is not None
        for slot in context.meal.announced_slots
    ):
        raise ConflictError(
            "The meal has no photographs to measure in: send the amount instead.",
            code="photographs_missing",
        )
    return Job(
        id=uuid.uuid4(),
        meal_id=context.meal.id,
        purpose="remeasure",
        event_id=context.event_id,
        state="queued",
        attempts=0,
        enqueued_at=context.now,
    )
