"""Days over the wire: the diary's, those of researchers, mean intakes."""

from datetime import date, datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

COVERAGE = "The share of the eaten grams for which it is known, 0 to 1; null: grams of something are not known."
UNMEASURED_MEALS = (
    "No food of theirs is known (failed, not measured yet), and nobody said there was none: missing in sums."
)
LEFTOVERS_UNKNOWN = (
    "Items that count as eaten up, since nobody has looked what was left of them, where the study expects an "
    "after-meal pair: with any, what was consumed is an upper bound."
)


class DayIn(BaseModel):
    """A word about a day: closed, all that was eaten is told; open, not so."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"status": "closed", "ate_nothing": False}})

    status: Literal["closed", "open"]
    ate_nothing: bool = False

    @model_validator(mode="after")
    def _nothing_is_all(self) -> "DayIn":
        if self.ate_nothing and self.status != "closed":
            raise ValueError("ate_nothing goes with the status closed")
        return self


class DayOut(BaseModel):
    """How a day stands. A day that is not listed is open, with version 0."""

    date: date
    study_day: int | None = Field(description="1 on the participant's first day.")
    status: Literal["closed", "open"]
    ate_nothing: bool = Field(description="Closed, and nothing was eaten: no meal says otherwise.")
    decided_by: Literal["participant", "reviewer"] | None = Field(description="Whose word holds; null: nobody's yet.")
    meals: int
    meals_after_closing: int = Field(description="Meals that came in after the day was closed: it may need a look.")
    version: int = Field(description='Goes into If-Match, as "3".')
    changed_at: datetime | None


class DayList(BaseModel):
    """Days that have a meal or a word, by date."""

    items: list[DayOut]


class PlausibilityOut(BaseModel):
    """Energy intake over basal metabolic rate, beside the 95 % limits for so many whole days (Goldberg, Black 2000)."""

    verdict: Literal["low", "plausible", "high", "unknown"]
    days: int
    ratio: float | None
    low: float | None
    high: float | None
    reason: str | None = Field(description="Why it is unknown.")


class DaySummaryOut(BaseModel):
    """What a participant ate on a day. What is not known is null, never 0; a sum of a part is told by its coverage."""

    study: str
    participant: str
    local_date: date
    study_day: int | None
    day_status: Literal["closed", "open"] = Field(description="Leave open days out of means.")
    ate_nothing: bool
    decided_by: Literal["participant", "reviewer"] | None
    meals: int
    meals_after_closing: int
    median_upload_delay_seconds: float | None = Field(description="From eating to the server, of the day's meals.")
    items: int
    unmeasured_meals: int = Field(description=UNMEASURED_MEALS)
    unmeasured_items: int = Field(description="Their grams are not known: the sums are of the others.")
    provisional_items: int = Field(description="An after-meal pair may still change them.")
    leftovers_unknown_items: int = Field(description=LEFTOVERS_UNKNOWN)
    consumed_g: float | None
    energy_kcal: float | None
    energy_kcal_coverage: float | None = Field(description=COVERAGE)
    protein_g: float | None
    protein_g_coverage: float | None
    fat_g: float | None
    fat_g_coverage: float | None
    carbohydrate_g: float | None
    carbohydrate_g_coverage: float | None
    fibre_g: float | None
    fibre_g_coverage: float | None
    sugar_g: float | None
    sugar_g_coverage: float | None
    saturated_fat_g: float | None
    saturated_fat_g_coverage: float | None
    sodium_mg: float | None
    sodium_mg_coverage: float | None
    potassium_mg: float | None
    potassium_mg_coverage: float | None
    vitamin_c_mg: float | None
    vitamin_c_mg_coverage: float | None
    energy_to_basal_rate: float | None
    plausibility: Literal["low", "plausible", "high", "unknown"] = Field(
        description="Of this day's energy alone, with the wide limits of one day; low, high: hardly all, or too much."
    )


class DaySummaryPage(BaseModel):
    """A page of days by date and participant; `next` leads to the page after it, null at the end."""

    items: list[DaySummaryOut]
    next: str | None = Field(description="The next page's path and query.")


class MeanAmountOut(BaseModel):
    """A mean daily amount; days: closed days on which it is known, of some items at least."""

    mean: float | None
    days: int
    coverage: float | None = Field(description=COVERAGE)


class IntakeOut(BaseModel):
    """A participant's mean daily intake over closed days; days on which nothing was eaten count as 0."""

    participant: str
    closed_days: int
    open_days: int = Field(description="Days with a meal or a word that were not closed: left out.")
    silent_days: int = Field(description="Days between the first and the last without a meal or a word.")
    first_day: date
    last_day: date
    unmeasured_meals: int = Field(description=UNMEASURED_MEALS)
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int = Field(description=LEFTOVERS_UNKNOWN)
    components: dict[str, MeanAmountOut] = Field(description="By the record's column, such as energy_kcal.")
    plausibility: PlausibilityOut = Field(description="Of closed days of which everything is measured and final.")


class IntakePage(BaseModel):
    """A page of participants by code; `next` leads to the page after it, null at the end."""

    items: list[IntakeOut]
    next: str | None
