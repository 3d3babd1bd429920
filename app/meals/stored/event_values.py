"""The value of an event, as stored in `meal_event.new`: one type per kind.

Unknown fields are ignored.
"""

import uuid
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from app.meals.stored.event_models import MealEvent
from app.meals.stored.outline_json import Polygon


class _Value(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Region(_Value):
    """Where a food is in the left photograph, px upright: one of the three."""

    point: list[float] | None = None
    box: list[float] | None = None
    polygon: Polygon | None = None


class AmountValue(_Value):
    """Grams or millilitres; neither if no amount was stated.

    portion_of: key of the food whose household measure was stated: the grams count while the item
    has this food.
    """

    mass_g: float | None = None
    of: Literal["as_seen", "edible"] = "as_seen"
    volume_ml: float | None = None
    relative_sd: float = 0.0
    portion_of: str | None = None


class SetAmount(AmountValue):
    """Another amount of an item.

    That of a form shaped by hand is its volume, which was computed with the event.
    """

    kind: Literal["set_volume", "set_mass", "reshape"]


class SetShare(_Value):
    """The participant's share of an item."""

    kind: Literal["set_share"]
    share: float


class Redraw(_Value):
    """Another outline of an item."""

    kind: Literal["redraw"]
    polygon: Polygon


class Add(AmountValue):
    """A food that the pipeline missed; without an amount it is measured in its region."""

    kind: Literal["add"]
    lies_as: str | None = None
    region: Region | None = None
    share: float | None = None


class Declare(AmountValue):
    """The answer to a probe; share None: that of the parent item."""

    kind: Literal["declare"]
    probe: str
    share: float | None = None


class Part(AmountValue):
    """One of the items that a split makes."""

    item: uuid.UUID
    lies_as: str | None = None
    polygon: Polygon | None = None


class Split(_Value):
    """The items that replace one."""

    kind: Literal["split"]
    parts: list[Part]
    share: float | None = None


class Merge(AmountValue):
    """The items that one replaces."""

    kind: Literal["merge"]
    items: list[uuid.UUID]
    share: float | None = None


class ConfirmMeal(_Value):
    """The items that the meal had when it was confirmed."""

    kind: Literal["confirm_meal"]
    items: list[uuid.UUID]


class Undo(_Value):
    """The event that is undone."""

    kind: Literal["undo"]
    event: uuid.UUID


class Answer(_Value):
    """The question that is answered."""

    kind: Literal["answer"]
    question: uuid.UUID


class Other(_Value):
    """Kinds without a value that the records depend on."""

    kind: Literal[
        "confirm", "reject", "set_food", "set_leftover", "nothing_left", "comment", "question"
    ]


EventValue = (
    SetAmount
    | SetShare
    | Redraw
    | Add
    | Declare
    | Split
    | Merge
    | ConfirmMeal
    | Undo
    | Answer
    | Other
)
_ADAPTER: TypeAdapter[EventValue] = TypeAdapter(Annotated[EventValue, Field(discriminator="kind")])


def value_of(event: MealEvent) -> EventValue:
    """Parse an event's value."""
    return _ADAPTER.validate_python({**event.new, "kind": event.kind})
