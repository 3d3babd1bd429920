"""A participant's feedback over the wire."""

import uuid
from datetime import date, datetime
from typing import Literal

from pydantic import BaseModel, Field


class EatenAmountOut(BaseModel):
    """An amount in the unit that its name ends with; null: not known. The interval holds with 90 % or more."""

    amount: float | None
    interval: tuple[float, float] | None
    coverage: float | None = Field(description="The share of the eaten grams for which it is known.")


class EatenMealOut(BaseModel):
    """One meal of the day."""

    meal_id: uuid.UUID
    captured_at: datetime
    items: int
    unmeasured_items: int
    components: dict[str, EatenAmountOut]


class ComparedOut(BaseModel):
    """A mean of days beside a reference intake of the participant's age and sex."""

    mean: float
    interval: tuple[float, float] = Field(
        description="90 %, of days as they differ; the measurement's doubt not in it."
    )
    days: int
    coverage: float
    reference: float
    kind: Literal["rda", "ai", "cdrr"]
    verdict: Literal["reaches", "below", "above_limit", "under_limit", "open", "open_adequate", "open_coverage"]


class ComparisonOut(BaseModel):
    """Days of the window beside reference intakes; `why_not` says why nothing is compared."""

    window_days: int
    closed_days: int
    whole_days: int = Field(description="Closed days of which everything is measured and final: they are compared.")
    why_not: Literal["days_needed", "profile_needed"] | None
    components: dict[str, ComparedOut]


class SummaryOut(BaseModel):
    """What a participant ate on a day, in figures and in plain sentences of the study's language."""

    date: date
    study_day: int | None
    status: Literal["closed", "open"]
    ate_nothing: bool
    meals: list[EatenMealOut]
    components: dict[str, EatenAmountOut] = Field(description="Of the whole day: amounts, compared with nothing.")
    unmeasured_meals: int = Field(description="No food of theirs is known: they are missing in the amounts.")
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int = Field(
        description="Counted as eaten up: nobody has looked what was left, where the study expects an after-meal pair."
    )
    comparison: ComparisonOut
    locale: str
    sentences: list[str] = Field(description="To be shown as they stand, in this order.")
    disclaimer: str = Field(description="To be shown beside them, always.")
