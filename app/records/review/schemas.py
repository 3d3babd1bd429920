"""Events as requests and answers carry them: one model per kind, discriminated by `kind`."""

import uuid
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import EVENT_KIND
from app.http.page_of import PageOf
from app.http.text_schemas import Number, Text
from app.meals.stored.event_models import EventKind, Layer
from app.nutrition.foods import FoodForm
from app.records.schemas import PlaceIn, Polygon
from app.vision.hand_form import HandSection

SHARES_SUM = 0.005  # how far off 1 the shares of a split may be: three thirds of 0.333

FoodKey = Annotated[
    Text, Field(min_length=1, max_length=100, description="A food's key (GET /v1/foods).")
]
LiesAs = Annotated[
    FoodForm | None, Field(description="How it lies there, where that is not as it usually does.")
]
MOST_ML = 20_000  # of any volume that an event states
Grams = Annotated[Number, Field(ge=0.001, le=20_000)]
Millilitres = Annotated[Number, Field(ge=0.001, le=MOST_ML)]
RelativeSd = Annotated[
    Number | None,
    Field(
        ge=0,
        le=2,
        description="How far off it may be, relative standard deviation; null: as usual.",
    ),
]
Words = Annotated[Text, Field(min_length=1, max_length=2000)]
Place = Annotated[Number, Field(ge=-5000, le=5000)]
Side = Annotated[Number, Field(ge=2, le=1000)]
Share = Annotated[Number, Field(ge=0.001, le=1)]


class AmountIn(ClosedModel):
    """How much: one of grams, millilitres, or a household measure of the food and how many of it."""

    mass_g: Grams | None = Field(
        default=None, description="Grams; instead of volume_ml or portion."
    )
    of: Literal["as_seen", "edible"] | None = Field(
        default=None,
        description="What the grams are of: with peel, core and bone (the default), or without.",
    )
    volume_ml: Millilitres | None = Field(
        default=None, description="Millilitres; instead of mass_g or portion."
    )
    portion: Text | None = Field(
        default=None, max_length=200, description="`measure` of one of the food's portions."
    )
    count: Annotated[Number, Field(ge=0.001, le=1000)] | None = Field(
        default=None, description="How many of the portion; needed with one."
    )
    relative_sd: RelativeSd = None

    @model_validator(mode="after")
    def _one_way(self) -> "AmountIn":
        given = [
            name for name in ("mass_g", "volume_ml", "portion") if getattr(self, name) is not None
        ]
        if len(given) != 1:
            raise ValueError("give one of mass_g, volume_ml and portion")
        if (self.count is not None) != (self.portion is not None):
            raise ValueError("portion and count go together")
        if self.of is not None and self.mass_g is None:
            raise ValueError("of goes with mass_g")
        return self


class RegionIn(PlaceIn):
    """Where a food is in the left photograph, upright pixels: one of point, box and polygon."""

    @model_validator(mode="after")
    def _one_place(self) -> "RegionIn":
        if sum(getattr(self, name) is not None for name in ("point", "box", "polygon")) != 1:
            raise ValueError("give one of point, box and polygon")
        if self.box is not None and (self.box[2] <= 0 or self.box[3] <= 0):
            raise ValueError("a box needs a positive width and height")
        return self


class _Event(ClosedModel):
    id: uuid.UUID = Field(
        description="Made by the client, once an event; the same again is the same event."
    )
    strict: bool = Field(
        default=False,
        description="Refuse an amount that can hardly be (422 `implausible_amount`), rather than flag the item.",
    )


class _OfItem(_Event):
    item: uuid.UUID = Field(description="The item that the event is about.")


class ConfirmIn(_OfItem):
    """The item is right as it stands."""

    kind: Literal["confirm"] = Field(description=EVENT_KIND)


class RejectIn(_OfItem):
    """The item is no food, or nobody ate of it."""

    kind: Literal["reject"] = Field(description=EVENT_KIND)


class SetFoodIn(_OfItem):
    """The item is this food."""

    kind: Literal["set_food"] = Field(description=EVENT_KIND)
    food: FoodKey
    lies_as: LiesAs = None


class SetVolumeIn(_OfItem):
    """The item is so large."""

    kind: Literal["set_volume"] = Field(description=EVENT_KIND)
    volume_ml: Millilitres = Field(description="Volume as served.")
    relative_sd: RelativeSd = None

    def amount(self) -> AmountIn:
        """Return the amount as other events give it."""
        return AmountIn(volume_ml=self.volume_ml, relative_sd=self.relative_sd)


class SetMassIn(_OfItem):
    """The item weighs so much, or is so many household measures of its food."""

    kind: Literal["set_mass"] = Field(description=EVENT_KIND)
    mass_g: Grams | None = Field(default=None, description="Grams; instead of portion.")
    of: Literal["as_seen", "edible"] | None = Field(
        default=None,
        description="What the grams are of: with peel, core and bone (as_seen, the default), or without (edible).",
    )
    portion: Text | None = Field(
        default=None,
        max_length=200,
        description="`measure` of one of the food's portions; instead of mass_g.",
    )
    count: Annotated[Number, Field(ge=0.001, le=1000)] | None = Field(
        default=None, description="How many of the portion; needed with one."
    )
    relative_sd: RelativeSd = None

    @model_validator(mode="after")
    def _an_amount(self) -> "SetMassIn":
        self.amount()
        return self

    def amount(self) -> AmountIn:
        """Return the amount as other events give it."""
        return AmountIn(
            mass_g=self.mass_g,
            of=self.of,
            portion=self.portion,
            count=self.count,
            relative_sd=self.relative_sd,
        )


class SetShareIn(_OfItem):
    """The participant ate this part of the item, a dish that was shared."""

    kind: Literal["set_share"] = Field(description=EVENT_KIND)
    share: Share = Field(description="The part that the participant ate, above 0 to 1.")


class RedrawIn(_OfItem):
    """The item is what this outline encloses; it is measured anew."""

    kind: Literal["redraw"] = Field(description=EVENT_KIND)
    polygon: Polygon = Field(
        description="Corners [x, y] of its outline in the left photograph's upright pixels, or a list of such rings "
        "with holes by the even-odd rule."
    )


class HandFormIn(ClosedModel):
    """A form in the table's frame of the meal's run (`scene.json`): mm, z up; angles in degrees."""

    section: HandSection = Field(
        description="`slab`: upright sides over a rectangle; `prism`: upright sides over an ellipse; `ellipsoid`."
    )
    centre_mm: tuple[Place, Place] = Field(description="x, y of the middle of its foot.")
    length_mm: Side = Field(description="Its extent in the direction of yaw_deg.")
    width_mm: Side = Field(description="Its extent across.")
    height_mm: Side = Field(description="Its extent upwards, also of a form that leans.")
    yaw_deg: Annotated[Number, Field(ge=-360, le=360)] = Field(
        description="From x to the length, counterclockwise."
    )
    lean_deg: Annotated[Number, Field(ge=-60, le=60)] = Field(
        default=0.0,
        description="How far its axis leans from upright towards its length: each level is moved sideways, so that the "
        "volume stays.",
    )
    base_mm: Annotated[Number, Field(ge=-100, le=500)] = Field(
        default=0.0, description="z of its foot."
    )


class ReshapeIn(_OfItem):
    """Reviewers: the item fills this form; its volume follows from it."""

    kind: Literal["reshape"] = Field(description=EVENT_KIND)
    form: HandFormIn = Field(
        description="Where it stands, and its sizes; the server computes its volume."
    )
    relative_sd: RelativeSd = None


class DeclareIn(_OfItem):
    """The answer to a probe of the item's food: `yes` with the food and, where it is known, how much of it."""

    kind: Literal["declare"] = Field(description=EVENT_KIND)
    probe: Text = Field(min_length=1, max_length=64, description="One of the item's `open_probes`.")
    answer: Literal["yes", "no", "unknown"] = Field(
        description="Whether there was any; with yes, `food` says what."
    )
    food: FoodKey | None = Field(
        default=None, description="Key of the food that there was; null: not known."
    )
    amount: AmountIn | None = Field(
        default=None, description="How much of it there was; null: not known."
    )
    share: Share | None = Field(
        default=None, description="Null: the share of the item that it came with."
    )

    @model_validator(mode="after")
    def _food_with_its_answer(self) -> "DeclareIn":
        if self.amount is not None and self.food is None:
            raise ValueError("an amount needs its food")
        if self.food is not None and self.answer == "unknown":
            raise ValueError("a food goes with `yes` or `no`")
        return self


class AddIn(_Event):
    """A food that was missed. With a place and no amount it is measured."""

    kind: Literal["add"] = Field(description=EVENT_KIND)
    food: FoodKey | None = Field(default=None, description="Key of the food; null: not known.")
    lies_as: LiesAs = None
    region: RegionIn | None = Field(
        default=None, description="Where it is in the left photograph; null: it cannot be seen."
    )
    amount: AmountIn | None = Field(
        default=None, description="How much of it there was; null: it is measured in its region."
    )
    share: Share | None = Field(
        default=None, description="Null: nothing is said of it, and all of it is theirs."
    )

    @model_validator(mode="after")
    def _something(self) -> "AddIn":
        if self.food is None and self.region is None:
            raise ValueError("give a food, a region or both")
        return self


class PartIn(ClosedModel):
    """One part of a split item: its share of the amount, its outline (then it is measured), its food if another."""

    share: Annotated[Number, Field(ge=0.001, lt=1)] | None = Field(
        default=None,
        description="Its part of the item's amount; either every part has one or none.",
    )
    polygon: Polygon | None = Field(
        default=None,
        description="Its outline in the left photograph's upright pixels; null: it is not measured by itself.",
    )
    food: FoodKey | None = Field(default=None, description="Key of its food; null: the item's.")
    lies_as: LiesAs = None

    @model_validator(mode="after")
    def _some_size(self) -> "PartIn":
        if self.share is None and self.polygon is None:
            raise ValueError("give a share, a polygon or both")
        return self


class SplitIn(_OfItem):
    """The item is several foods, or several pieces."""

    kind: Literal["split"] = Field(description=EVENT_KIND)
    parts: list[PartIn] = Field(min_length=2, max_length=10, description="What it is split into.")

    @model_validator(mode="after")
    def _whole(self) -> "SplitIn":
        shares = [part.share for part in self.parts if part.share is not None]
        if shares and len(shares) < len(self.parts):
            raise ValueError("give the share of every part, or of none")
        if shares and abs(sum(shares) - 1.0) > SHARES_SUM:
            raise ValueError("the shares of the parts must sum to 1")
        return self


class MergeIn(_Event):
    """The items are one."""

    kind: Literal["merge"] = Field(description=EVENT_KIND)
    items: list[uuid.UUID] = Field(
        min_length=2, max_length=20, description="The items that are one."
    )
    food: FoodKey | None = Field(
        default=None, description="What they are together; needed where they differ."
    )
    lies_as: LiesAs = None

    @model_validator(mode="after")
    def _each_once(self) -> "MergeIn":
        if len(set(self.items)) < len(self.items):
            raise ValueError("an item is named twice")
        if self.lies_as is not None and self.food is None:
            raise ValueError("lies_as goes with a food")
        return self


class SetLeftoverIn(_OfItem):
    """A piece of the after-meal pair (`item`: its id) is food left of an item, refuse of it, or of none of them."""

    model_config = ConfigDict(serialize_by_alias=True)

    kind: Literal["set_leftover"] = Field(description=EVENT_KIND)
    of: uuid.UUID | None = Field(
        description="The item of the meal; null: of none of them, it counts for nothing."
    )
    leftover_class: Literal["food_left", "refuse", "unmatched"] = Field(
        alias="class", description="unmatched goes with no item."
    )

    @model_validator(mode="after")
    def _of_an_item(self) -> "SetLeftoverIn":
        if (self.of is None) != (self.leftover_class == "unmatched"):
            raise ValueError("food_left and refuse are of an item, unmatched is of none")
        return self


class NothingLeftIn(_Event):
    """All of the meal was eaten: no after-meal pair will come."""

    kind: Literal["nothing_left"] = Field(description=EVENT_KIND)


class ConfirmMealIn(_Event):
    """The meal is right as it stands."""

    kind: Literal["confirm_meal"] = Field(description=EVENT_KIND)


class CommentIn(_Event):
    """A remark; participant and reviewers see each other's."""

    kind: Literal["comment"] = Field(description=EVENT_KIND)
    item: uuid.UUID | None = Field(
        default=None, description="The item that it is about; null: the meal as a whole."
    )
    text: Words = Field(description="The remark.")


class QuestionIn(_Event):
    """Reviewers: ask the participant (GET /v1/me/questions)."""

    kind: Literal["question"] = Field(description=EVENT_KIND)
    item: uuid.UUID | None = Field(
        default=None, description="The item that it is about; null: the meal as a whole."
    )
    text: Words = Field(description="The question.")


class AnswerIn(_Event):
    """Participants: answer a question."""

    kind: Literal["answer"] = Field(description=EVENT_KIND)
    question: uuid.UUID = Field(description="The question's event.")
    text: Words = Field(description="The answer.")


class UndoIn(_Event):
    """Take an event back: one's own, a reviewer also the participant's."""

    kind: Literal["undo"] = Field(description=EVENT_KIND)
    event: uuid.UUID = Field(description="The event to take back.")


AnyEventIn = (
    ConfirmIn
    | RejectIn
    | SetFoodIn
    | SetVolumeIn
    | SetMassIn
    | SetShareIn
    | RedrawIn
    | ReshapeIn
    | DeclareIn
    | AddIn
    | SplitIn
    | MergeIn
    | SetLeftoverIn
    | NothingLeftIn
    | ConfirmMealIn
    | CommentIn
    | QuestionIn
    | AnswerIn
    | UndoIn
)
EventIn = Annotated[AnyEventIn, Field(discriminator="kind")]


def item_of(event: AnyEventIn) -> uuid.UUID | None:
    """Return the id of the item that the event is about, if it is about one."""
    return event.item if isinstance(event, _OfItem | CommentIn | QuestionIn) else None


class EventOut(BaseModel):
    """One word of somebody about the meal; old and new values in the words of the request."""

    id: uuid.UUID = Field(description="The event's id, as its client made it.")
    sequence: int = Field(description="Its number in the meal, from 1.")
    kind: EventKind = Field(description="What kind of event it is.")
    layer: Layer = Field(
        description="participant or reviewer: the reviewer's word goes over the participant's."
    )
    author: str = Field(
        description="Staff see who it was; a participant sees `participant` or `reviewer`."
    )
    item: uuid.UUID | None = Field(
        description="The item that it is about; null: the meal as a whole."
    )
    old: dict[str, Any] = Field(
        description="What the event replaced, in the fields of the request; empty where there was nothing."
    )
    new: dict[str, Any] = Field(description="What the event says, in the fields of the request.")
    undone: bool = Field(description="Whether it was taken back.")
    created_at: datetime = Field(description="When it arrived.")


class EventList(PageOf[EventOut]):
    """A page of a meal's history, the oldest first."""

    next: str | None = Field(description="Path of the next page; null: this is the last.")
