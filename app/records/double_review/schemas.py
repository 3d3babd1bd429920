"""Double review over the wire: decisions, and items with a known answer."""

import uuid
from datetime import datetime

from pydantic import Base64Bytes, BaseModel, Field, model_validator

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import MEAL_ID, LocalDate, ParticipantCode
from app.records.review.schemas import FoodKey, Grams
from app.records.schemas import Polygon

AS_SERVED = "Grams as served, with peel, core and bone; null: it is no food."
ITEM = "The item's id."


class DecisionIn(ClosedModel):
    """A food and its grams; without both the item is no food, or nobody ate of it."""

    item: uuid.UUID
    food: FoodKey | None = None
    mass_g: Grams | None = None

    @model_validator(mode="after")
    def _both_or_none(self) -> "DecisionIn":
        if (self.food is None) != (self.mass_g is None):
            raise ValueError("food and grams go together")
        return self


class DecisionOut(BaseModel):
    """One of the decisions about an item that two have decided."""

    item: uuid.UUID = Field(description=ITEM)
    meal: uuid.UUID = Field(description=MEAL_ID)
    participant: ParticipantCode
    local_date: LocalDate
    reviewer: str = Field(description="The reviewer's name.")
    is_final: bool = Field(description="Whether it is a third reviewer's, who saw the two.")
    food_key: str | None = Field(description="The food's key; null: it is no food.")
    mass_g: float | None = Field(description=AS_SERVED)
    energy_kcal: float | None = Field(description="Energy of these grams; null: not known.")
    decided_at: datetime = Field(description="When it arrived.")
    settled_at: datetime | None = Field(description="When the item was settled; null: it waits.")


class DecisionList(BaseModel):
    """Decisions about items that two have decided, item by item."""

    items: list[DecisionOut] = Field(description="Two decisions of an item, or three.")


class KnownItemIn(ClosedModel):
    """An item with a known answer, of no participant."""

    food: FoodKey
    mass_g: Grams = Field(description="True grams as served.")
    shown_g: Grams = Field(description="Grams that reviewers see as measured.")
    polygon: Polygon
    picture: Base64Bytes = Field(
        max_length=700_000, description="JPEG, PNG, WebP or HEIC, in base64."
    )
