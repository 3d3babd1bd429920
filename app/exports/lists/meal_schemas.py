"""Schemas of lists of meals."""

import uuid
from datetime import datetime

from pydantic import BaseModel, Field

from app.foods.schemas import FoodRef
from app.http.field_descriptions import (
    MEAL_VERSION,
    RECEIVED_AT,
    STUDY,
    TIME_ZONE,
    CapturedAt,
    LocalDate,
    ParticipantCode,
)
from app.http.page_of import PageOf
from app.meals.stored.models import AfterStatus, MealOrigin, MealStatus


class MealLinks(BaseModel):
    """Paths, to be used unchanged."""

    meal: str = Field(description="Path of the meal.")
    photograph_left: str | None = Field(
        description="Path of the left photograph; null: not arrived, or erased."
    )


class MealListItem(BaseModel):
    """A meal of a list. Figures are of records that count (not rejected); `GET meal` has the intervals."""

    id: uuid.UUID = Field(description="The id that the phone made.")
    study: str = Field(description=STUDY)
    participant: ParticipantCode
    status: MealStatus = Field(
        description="receiving, queued, processing, estimated, needs_review, failed or confirmed"
    )
    stage: str | None = Field(
        description="The pipeline's step while processing; `waits_for_room` between attempts."
    )
    failure_code: str | None = Field(
        description="Why it could not be measured (docs/errors.md); null: it has not failed."
    )
    captured_at: CapturedAt
    time_zone: str = Field(description=TIME_ZONE)
    local_date: LocalDate
    received_at: datetime = Field(description=RECEIVED_AT)
    upload_delay_seconds: float = Field(
        description="From eating to the arrival of the meal's first part."
    )
    origin: MealOrigin = Field(description="photographed or declared")
    after_status: AfterStatus | None = Field(
        description="Status of its after-meal pair; null: nothing has arrived."
    )
    provisional: bool = Field(description="An after-meal pair may still come.")
    version: int = Field(description=MEAL_VERSION)
    item_count: int = Field(description="Items that count (not rejected).")
    foods: list[FoodRef] = Field(description="Known foods in the order of the items, each once.")
    consumed_g: float | None = Field(
        description="Of the items whose grams are known, signed; null: of none."
    )
    energy_kcal: float | None = Field(
        description="Of the items whose energy is known; null: of none."
    )
    unmeasured_items: int = Field(
        description="Items whose grams are not known; above 0, the sums are incomplete."
    )
    items_without_energy: int = Field(
        description="Items whose energy is not known, those without grams included."
    )
    doubt: float | None = Field(
        description="The greatest of its items, 0 to 1, as the review queue orders them."
    )
    flags: list[str] = Field(description="Flags of its items.")
    links: MealLinks = Field(description="Paths of the meal and its photograph.")


class MealPage(PageOf[MealListItem]):
    """A page of meals by time of capture; `next` leads to the page after it, null at the end."""

    next: str | None = Field(description="The next page's path and query.")


class StatusCountOut(BaseModel):
    """The number of meals with a status. `is_more`: there are more than `count`."""

    status: MealStatus = Field(description="The meals' status.")
    count: int = Field(description="Number of meals, up to 1,000.")
    is_more: bool = Field(description="Whether there are more than `count`.")


class MealCounts(BaseModel):
    """Counts by status, up to 1,000 each."""

    items: list[StatusCountOut] = Field(
        description="One entry per status, in the order in which a meal goes through them."
    )
    needs_look: int = Field(description="Meals with an item in the review queue, up to 1,000.")


class ChangedMeals(BaseModel):
    """Those of the given meals whose version has changed."""

    items: list[MealListItem] = Field(description="The changed meals, in their current state.")
