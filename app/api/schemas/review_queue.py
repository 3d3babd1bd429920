"""The reviewers' queue and the participant's open questions over the wire."""

import uuid
from datetime import date, datetime

from pydantic import BaseModel, Field

from app.api.schemas.foods import FoodRef
from app.api.schemas.meals import CandidateOut


class QueuedItemOut(BaseModel):
    """An item that no reviewer has spoken of, with what a decision needs."""

    item: uuid.UUID
    meal: uuid.UUID
    participant: str
    doubt: float = Field(description="0 to 1; 1 where food or amount are not known (docs/review.md).")
    status: str
    origin: str
    provisional: bool
    food: FoodRef | None
    candidates: list[CandidateOut] = Field(description="Best first: choose one by `set_food`.")
    none_of_these: float | None = Field(
        description="Probability that it is none of the index's candidates; null: the index was not asked."
    )
    volume_ml: float | None
    volume_interval_ml: tuple[float, float] | None = Field(description="90 % interval.")
    mass_g: float | None
    mass_interval_g: tuple[float, float] | None = Field(description="90 % interval.")
    share: float
    left_g: float | None
    consumed_g: float | None
    consumed_interval_g: tuple[float, float] | None = Field(description="90 % interval.")
    energy_kcal: float | None
    flags: list[str]
    captured_at: datetime
    local_date: date
    etag: str = Field(description="The meal's, for `If-Match` of the event.")
    meal_href: str
    photograph_href: str | None = Field(description="The left photograph; null: the meal was told without any.")


class ReviewQueue(BaseModel):
    """A page of the queue, the most doubtful first."""

    items: list[QueuedItemOut]
    next: str | None = Field(description="Path of the next page; null: this is the last.")


class QuestionOut(BaseModel):
    """A question that waits for the participant's answer (event kind `answer` of the meal)."""

    id: uuid.UUID
    meal: uuid.UUID
    item: uuid.UUID | None
    text: str
    asked_at: datetime
    captured_at: datetime
    local_date: date
    etag: str = Field(description="The meal's, for `If-Match` of the answer.")


class QuestionList(BaseModel):
    """Open questions, the newest first; at most 100."""

    items: list[QuestionOut]
