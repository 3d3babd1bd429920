"""The reviewers' queue and the participant's open questions over the wire."""

import uuid
from datetime import datetime

from pydantic import BaseModel, Field

from app.foods.schemas import FoodRef
from app.http.field_descriptions import (
    FLAGS,
    FOOD,
    MEAL_ID,
    CapturedAt,
    Interval,
    LocalDate,
    ParticipantCode,
)
from app.http.page_of import PageOf
from app.meals.stored.record_models import ItemOrigin, RecordStatus
from app.records.meal_schemas import CandidateOut


class QueuedItemOut(BaseModel):
    """An item that needs a look, with what a decision needs."""

    item: uuid.UUID = Field(description="The item's id.")
    meal: uuid.UUID = Field(description=MEAL_ID)
    participant: ParticipantCode
    doubt: float = Field(
        description="0 to 1; 1 where food or amount are not known (docs/review.md)."
    )
    status: RecordStatus = Field(description="What people have made of the item.")
    origin: ItemOrigin = Field(description="Where the item comes from.")
    provisional: bool = Field(
        description="Whether an after-meal pair may still change what was eaten."
    )
    food: FoodRef | None = Field(description=FOOD)
    candidates: list[CandidateOut] = Field(description="Best first: choose one by `set_food`.")
    none_of_these: float | None = Field(
        description="Probability that it is none of the index's candidates; null: the index was not asked."
    )
    volume_ml: float | None = Field(description="Volume as served; null: not measured.")
    volume_interval_ml: Interval
    mass_g: float | None = Field(
        description="Grams as served, with peel, core and bone; null: not known."
    )
    mass_interval_g: Interval
    share: float = Field(
        description="The participant's share of a dish that is shared, 0 to 1; 1: all of it."
    )
    left_g: float | None = Field(description="Edible grams left over; null: nobody has looked.")
    consumed_g: float | None = Field(
        description="Edible grams eaten: (edible - left) x share; null: not known."
    )
    consumed_interval_g: Interval
    energy_kcal: float | None = Field(description="Energy of what was eaten; null: not known.")
    flags: list[str] = Field(description=FLAGS)
    captured_at: CapturedAt
    local_date: LocalDate
    etag: str = Field(description="The meal's, for `If-Match` of the event.")
    meal_href: str = Field(description="Path of the meal.")
    photograph_href: str | None = Field(
        description="The left photograph; null: the meal was told without any."
    )


class ReviewQueue(PageOf[QueuedItemOut]):
    """A page of the queue, the most doubtful first."""

    next: str | None = Field(description="Path of the next page; null: this is the last.")


class QuestionOut(BaseModel):
    """A question that waits for the participant's answer (event kind `answer` of the meal)."""

    id: uuid.UUID = Field(description="The question's event: the answer names it.")
    meal: uuid.UUID = Field(description=MEAL_ID)
    item: uuid.UUID | None = Field(
        description="The item that it is about; null: the meal as a whole."
    )
    text: str = Field(description="The question, as the reviewer wrote it.")
    asked_at: datetime = Field(description="When it was asked.")
    captured_at: CapturedAt
    local_date: LocalDate
    etag: str = Field(description="The meal's, for `If-Match` of the answer.")


class QuestionList(BaseModel):
    """Open questions, the newest first; at most 100."""

    items: list[QuestionOut] = Field(description="The open questions.")
