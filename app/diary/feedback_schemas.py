"""HTTP schemas of a participant's feedback."""

import uuid
from datetime import date, datetime
from typing import Annotated

from pydantic import BaseModel, Field

from app.diary.feedback import NoComparison
from app.http.field_descriptions import CAPTURED_AT, MEAL_ID, STUDY_DAY
from app.meals.stored.day_models import DayStatus
from app.nutrition.intakes.compare_intake import Kind, Verdict
from app.people.models import Locale


class EatenAmountOut(BaseModel):
    """An amount and its interval of at least 90 %."""

    amount: float | None = Field(
        description="In the unit that the component's name ends with; null: unknown."
    )
    interval: tuple[float, float] | None = Field(
        description="[low, high], contains the true amount with a probability of at least 90 %; null: unknown."
    )
    coverage: float | None = Field(
        description="The share of the eaten grams for which it is known."
    )


class EatenMealOut(BaseModel):
    """One meal of the day."""

    meal_id: uuid.UUID = Field(description=MEAL_ID)
    captured_at: datetime = Field(description=CAPTURED_AT)
    items: int = Field(description="Items of the meal that count (not rejected).")
    unmeasured_items: int = Field(
        description="Items whose eaten grams are unknown: missing from the amounts."
    )
    components: dict[str, EatenAmountOut] = Field(
        description="Amounts by the record's column, such as energy_kcal."
    )


class ComparedOut(BaseModel):
    """A mean of days beside a reference intake of the participant's age and sex."""

    mean: float = Field(
        description="Mean per day, in the unit that the component's name ends with."
    )
    interval: tuple[float, float] = Field(
        description="90 % interval from day-to-day variation; measurement error is not included."
    )
    days: int = Field(description="Number of days in the mean.")
    coverage: float = Field(
        description="Mean over the days of the share of the eaten grams for which the component is known, 0 to 1."
    )
    reference: float = Field(description="The reference intake per day, in the same unit.")
    kind: Kind = Field(
        description="rda: Recommended Dietary Allowance. ai: Adequate Intake. cdrr: Chronic Disease Risk Reduction "
        "intake."
    )
    verdict: Verdict = Field(
        description="What the days show: reaches, below: an RDA or AI. above_limit, under_limit: a CDRR. open: the "
        "days do not show it. open_adequate: below an AI, from which nothing follows. open_coverage: not all "
        "contents are known."
    )


class ComparisonOut(BaseModel):
    """Days of the window beside reference intakes; `why_not` says why nothing is compared."""

    window_days: int = Field(
        description="Length of the window in days; it ends with the summary's day."
    )
    closed_days: int = Field(description="Closed days in the window.")
    whole_days: int = Field(
        description="Closed days that are measured and final: these are compared."
    )
    why_not: NoComparison | None = Field(
        description="days_needed: too few whole days. profile_needed: age or sex is unknown. Null: there is a "
        "comparison."
    )
    components: dict[str, ComparedOut] = Field(
        description="By the record's column, such as fibre_g; empty without a comparison."
    )


class SummaryOut(BaseModel):
    """What a participant ate on a day, in figures and in plain sentences of the study's language."""

    date: Annotated[date, Field(description="The participant's local day.")]
    study_day: int | None = Field(description=STUDY_DAY)
    status: DayStatus = Field(
        description="closed: all that was eaten on the day is recorded. open: not all."
    )
    ate_nothing: bool = Field(description="Whether the day is closed and nothing was eaten on it.")
    meals: list[EatenMealOut] = Field(description="The day's meals.")
    components: dict[str, EatenAmountOut] = Field(
        description="Amounts of the whole day, without a comparison."
    )
    unmeasured_meals: int = Field(
        description="Meals without a known food: missing from the amounts."
    )
    unmeasured_items: int = Field(
        description="Items whose eaten grams are unknown: missing from the amounts."
    )
    provisional_items: int = Field(description="Items that an after-meal pair may still change.")
    leftovers_unknown_items: int = Field(
        description="Items counted as eaten up because no leftovers were recorded, where the study expects an "
        "after-meal pair."
    )
    comparison: ComparisonOut = Field(
        description="Means of the last days beside reference intakes."
    )
    locale: Locale = Field(description="The language of the sentences.")
    sentences: list[str] = Field(description="Show them unchanged, in this order.")
    disclaimer: str = Field(description="Always show it beside the sentences.")
