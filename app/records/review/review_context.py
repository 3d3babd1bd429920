"""What the rules of all kinds of events share: the meal before the event, the change that a rule returns, its rows."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from sqlalchemy.orm import Session

from app.core.errors import ConflictError, InvalidInputError, NotFoundError
from app.db.base import Base
from app.foods import queries as foods
from app.foods.models import Food
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
from app.records.review.schemas import PartIn, RegionIn

ITEMS_OF_EVENT = uuid.UUID(
    "b1c4b7a3-8a0f-4f27-8d9d-2d9a4b2f60c5"
)  # random namespace of the ids of created items


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

        Raises NotFoundError if the meal has no such item, ConflictError if it was replaced or undone.
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
    """Return the food with this key in the tables in force. Raises InvalidInputError (`food_unknown`)."""
    food = foods.foods_by_key(session, {key}).get(key)
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
    """Return the row that assigns an item to a food, with current densities. earlier: the item's rows so far."""
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
    """Return the job that measures the event's regions. Raises ConflictError if a photograph is missing."""
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
