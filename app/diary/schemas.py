"""HTTP schemas of days: the diary, day summaries for researchers, mean intakes."""

from datetime import date, datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from app.http.columns.day_columns import SUMS
from app.http.field_descriptions import DAY, NEXT, PAGE, PARTICIPANT, with_numbers
from app.meals.stored.day_models import DayStatus
from app.nutrition.plausible_energy import Verdict, WhyUnknown

COVERAGE = "The share of the eaten grams for which it is known, 0 to 1; null: the grams of some item are unknown."
UNMEASURED_MEALS = (
    "Meals without a known food (failed, or not measured yet) that are not confirmed to have none: "
    "missing from sums."
)
LEFTOVERS_UNKNOWN = (
    "Items counted as eaten up because no leftovers were recorded, where the study expects an after-meal pair: with "
    "any, consumed amounts are upper bounds."
)


class DayIn(BaseModel):
    """An entry about a day. closed: all that was eaten is recorded; open: not all."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"example": {"status": "closed", "ate_nothing": False}}
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


class DaySummaryPage(BaseModel):
    """A page of days by date and participant; `next` is the address of the next page, null on the last one."""

    items: list[DaySummaryOut] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)


class MeanAmountOut(BaseModel):
    """A mean daily amount over closed days on which it is known for at least one item."""

    mean: float | None = Field(
        description="Mean amount per day, in the unit that the component's name ends with; null: known on no day."
    )
    days: int = Field(description="Closed days on which the amount is known for at least one item.")
    coverage: float | None = Field(description=COVERAGE)


class IntakeOut(BaseModel):
    """A participant's mean daily intake over closed days; days on which nothing was eaten count as 0."""

    participant: str = Field(description=PARTICIPANT)
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


class IntakePage(BaseModel):
    """A page of participants by code; `next` is the address of the next page, null on the last one."""

    items: list[IntakeOut] = Field(description=PAGE)
    next: str | None = Field(description=NEXT)
