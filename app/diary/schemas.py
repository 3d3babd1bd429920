"""HTTP schemas of days: the diary, day summaries for researchers, mean intakes, feedback, adequacy."""

import uuid
from datetime import date, datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.closed_model import ClosedModel
from app.http.columns.day_columns import SUMS
from app.http.field_descriptions import (
    DAY,
    MEAL_ID,
    NUMBER,
    STUDY_DAY,
    CapturedAt,
    ParticipantCode,
    with_numbers,
)
from app.http.page_of import PageOf
from app.meals.stored.event_models import DayStatus
from app.nutrition.intakes.compare_intake import Kind
from app.nutrition.intakes.compare_intake import Verdict as Comparison
from app.nutrition.intakes.life_stage import LifeStage
from app.nutrition.intakes.reference_intakes import Per
from app.nutrition.plausible import Verdict, WhyUnknown
from app.people.models import Locale

NoComparison = Literal["days_needed", "profile_needed"]
Reason = Literal[
    "energy_follows_need",
    "no_ear",
    "need_is_skewed",
    "intake_is_lower_bound",
    "too_few_persons",
    "no_repeated_days",
    "no_difference_between_persons",
]
COVERAGE = "The share of the eaten grams for which it is known, 0 to 1; null: the grams of some item are unknown."
UNMEASURED_MEALS = (
    "Meals without a known food (failed, or not measured yet) that are not confirmed to have none: "
    "missing from sums."
)
LEFTOVERS_UNKNOWN = (
    "Items counted as eaten up because no leftovers were recorded, where the study expects an after-meal pair: with "
    "any, consumed amounts are upper bounds."
)


class DayIn(ClosedModel):
    """An entry about a day. closed: all that was eaten is recorded; open: not all."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"status": "closed", "ate_nothing": False}}
    )

    status: DayStatus = Field(
        description="closed: all that was eaten on the day is recorded. open: not all."
    )
    ate_nothing: bool = Field(
        default=False, description="With closed: nothing was eaten on the day."
    )

    @model_validator(mode="after")
    def _nothing_is_all(self) -> "DayIn":
        if self.ate_nothing and self.status != "closed":
            raise ValueError("ate_nothing goes with the status closed")
        return self


class DayOut(BaseModel):
    """A day's state. A day that is not listed is open, with version 0."""

    date: Annotated[
        date, Field(validation_alias="local_date", description="The participant's local day.")
    ]
    study_day: int | None = Field(description="1 on the participant's first day.")
    status: DayStatus = Field(
        description="closed: all that was eaten on the day is recorded. open: not all, or nobody has closed it."
    )
    ate_nothing: bool = Field(
        description="Whether the day is closed with nothing eaten and has no meal."
    )
    decided_by: Literal["participant", "reviewer"] | None = Field(
        description="Whose diary entry is in effect; null: there is none."
    )
    meals: int = Field(description="Meals of the day.")
    meals_after_closing: int = Field(
        description="Meals that arrived after the day was closed: check the day again."
    )
    version: int = Field(description='Goes into If-Match, as "3".')
    changed_at: datetime | None = Field(
        description="When the day was last closed or reopened; null: never."
    )


class DayList(BaseModel):
    """Days that have a meal or a diary entry, by date."""

    items: list[DayOut] = Field(description="Days that have a meal or a diary entry, by date.")


class PlausibilityOut(BaseModel):
    """Energy intake over basal metabolic rate, beside the 95 % limits for so many whole days (Goldberg, Black 2000)."""

    verdict: Verdict = Field(
        description="low, high: outside the limits. unknown: `reason` says why."
    )
    days: int = Field(description="Number of whole days in the mean.")
    ratio: float | None = Field(
        description="Mean energy intake over basal metabolic rate; null: unknown."
    )
    low: float | None = Field(description="Lower limit of a plausible ratio; null: unknown.")
    high: float | None = Field(description="Upper limit of a plausible ratio; null: unknown.")
    reason: WhyUnknown | None = Field(description="Why it is unknown.")


@with_numbers(SUMS)
class DaySums(BaseModel):
    """A participant's day up to its sums of headline components."""

    study: str = Field(description=DAY["study"])
    participant: str = Field(description=DAY["participant"])
    local_date: date = Field(description=DAY["local_date"])
    study_day: int | None = Field(description=DAY["study_day"])
    day_status: DayStatus = Field(description="Leave open days out of means.")
    ate_nothing: bool = Field(description=DAY["ate_nothing"])
    decided_by: Literal["participant", "reviewer"] | None = Field(description=DAY["decided_by"])
    meals: int = Field(description=DAY["meals"])
    meals_after_closing: int = Field(description=DAY["meals_after_closing"])
    median_upload_delay_seconds: float | None = Field(
        description="From eating to the server, of the day's meals."
    )
    items: int = Field(description=DAY["items"])
    unmeasured_meals: int = Field(description=UNMEASURED_MEALS)
    unmeasured_items: int = Field(
        description="Items whose eaten grams are unknown: missing from sums."
    )
    provisional_items: int = Field(description="Items that an after-meal pair may still change.")
    leftovers_unknown_items: int = Field(description=LEFTOVERS_UNKNOWN)
    consumed_g: float | None = Field(description=DAY["consumed_g"])


class DaySummaryOut(DaySums):
    """What a participant ate on a day. Unknown values are null, never 0; coverage tells which sums are partial."""

    energy_to_basal_rate: float | None = Field(description=DAY["energy_to_basal_rate"])
    plausibility: Verdict = Field(
        description="Of this day's energy alone, with the wide limits of one day. low, high: outside the limits."
    )


class DaySummaryPage(PageOf[DaySummaryOut]):
    """A page of days by date and participant; `next` is the address of the next page, null on the last one."""


class MeanAmountOut(BaseModel):
    """A mean daily amount over closed days on which it is known for at least one item."""

    mean: float | None = Field(
        description="Mean amount per day, in the unit that the component's name ends with; null: known on no day."
    )
    days: int = Field(description="Closed days on which the amount is known for at least one item.")
    coverage: float | None = Field(description=COVERAGE)


class IntakeOut(BaseModel):
    """A participant's mean daily intake over closed days; days on which nothing was eaten count as 0."""

    participant: ParticipantCode
    closed_days: int = Field(description="Closed days, over which the means are taken.")
    open_days: int = Field(
        description="Days with a meal or a diary entry that are not closed: left out."
    )
    silent_days: int = Field(
        description="Days between the first and the last without a meal or a diary entry."
    )
    first_day: date = Field(
        description="First local day of the window with a meal or a diary entry."
    )
    last_day: date = Field(description="Last local day of the window with a meal or a diary entry.")
    unmeasured_meals: int = Field(description=UNMEASURED_MEALS)
    unmeasured_items: int = Field(
        description="Items whose eaten grams are unknown: missing from the means."
    )
    provisional_items: int = Field(description="Items that an after-meal pair may still change.")
    leftovers_unknown_items: int = Field(description=LEFTOVERS_UNKNOWN)
    components: dict[str, MeanAmountOut] = Field(
        description="By the record's column, such as energy_kcal."
    )
    plausibility: PlausibilityOut = Field(
        description="Of the closed days that are measured and final."
    )


class IntakePage(PageOf[IntakeOut]):
    """A page of participants by code; `next` is the address of the next page, null on the last one."""


class VariancesOut(BaseModel):
    """Variance components on the scale of analysis."""

    scale: Literal["as_is", "square_root", "cube_root", "fourth_root", "logarithm"] = Field(
        description="The scale on which the group's days are closest to normally distributed, used for the analysis."
    )
    within: float = Field(description="Variance of a person's days.")
    between: float = Field(description="Variance of usual intakes between persons.")


class StageAdequacyOut(BaseModel):
    """The result of one life stage; `reason` tells why there is no share."""

    life_stage: LifeStage = Field(
        description="The group by age, sex, pregnancy and lactation, as the reference intakes define it."
    )
    persons: int = Field(description="Participants whose days were used.")
    days: int = Field(description="Closed days that were used.")
    days_left_out: int = Field(
        description="Closed days that are not measured and final, or whose coverage is too low."
    )
    ear: float | None = Field(
        description="Estimated Average Requirement in the component's unit, per `per`; null: the source sets none."
    )
    per: Per | None = Field(
        description="Whether `ear` and the intakes are per day, or per day and kilogram of body weight; null: there "
        "is no reference."
    )
    compared_with: str | None = Field(
        description="The component that is compared with the EAR, and caveats; null: there is no reference."
    )
    mean_usual_intake: float | None = Field(
        description="Mean of the group's usual intakes, in the unit of `ear`; null if there is a `reason`."
    )
    share_below_ear: float | None = Field(
        description="Share of the group whose usual intake is below the EAR, 0 to 1; null if there is a `reason`."
    )
    share_interval: tuple[float, float] | None = Field(
        description="90 % interval of the share, over persons and the adjustment."
    )
    unadjusted_share: float | None = Field(
        description="Share from plain means of days: biased, for comparison."
    )
    variances: VariancesOut | None = Field(
        description="Variance within and between persons; null if there is a `reason`."
    )
    reason: Reason | None = Field(description="Why there is no share; null: there is one.")


class AdequacyOut(BaseModel):
    """The share of each group whose usual intake lies below the EAR."""

    number: str = Field(description=NUMBER)
    tagname: str | None = Field(description="INFOODS tagname, such as VITC; null: there is none.")
    name: str = Field(description="The component's name.")
    unit: str = Field(description="Unit of the amounts.")
    groups: list[StageAdequacyOut] = Field(
        description="One entry per life stage that has participants."
    )
    persons_without_stage: int = Field(
        description="Participants left out because their life stage, or a weight it needs, is unknown."
    )
    method: str = Field(
        description="How the shares were computed, with the sources, for a paper's methods section."
    )


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
    captured_at: CapturedAt
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
    verdict: Comparison = Field(
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
