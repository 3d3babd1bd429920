"""HTTP schemas of a study's overview; each list is also a CSV table with the same rows."""

import uuid
from datetime import date
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field

from app.diary.schemas import UNMEASURED_MEALS
from app.http.field_descriptions import (
    MEAL_ID,
    STUDY,
    CapturedAt,
    LocalDate,
    ParticipantCode,
)
from app.meals.stored.models import MealStatus

CountedStatus = Literal[MealStatus, "needs_look", "after_awaited", "after_failed"]
WHOLE = (
    "Closed days that are measured and final, or on which nothing was eaten, with all energy known."
)
LATE = "Meals that arrived more than 24 hours after they were eaten."


class OverviewPeopleOut(BaseModel):
    """Numbers of participants."""

    everybody: int = Field(description="All participants, including those who have left.")
    active: int = Field(description="Participants with a meal in the window.")
    withdrawn: int = Field(
        description="Participants who have left, whatever was done with their data."
    )
    erased: int = Field(description="Of the withdrawn: those whose data were erased.")


class CompletenessOut(BaseModel):
    """Participant-days of the window."""

    expected: int = Field(
        description="From each participant's first day until they left, today at the latest."
    )
    told: int = Field(description="Expected days with a meal or closed.")
    silent: int = Field(description="Expected days without a meal that are not closed.")
    closed: int = Field(description="Participant-days that are closed.")
    whole: int = Field(description=WHOLE)
    meals: int = Field(description="Meals of the window.")
    late_meals: int = Field(description=LATE)
    median_delay_seconds: float | None = Field(
        description="From eating to arrival, of the window's meals."
    )


class OverviewDayOut(BaseModel):
    """A local day of the window: numbers of participants, unless the name says meals or items."""

    local_date: date = Field(description="The local day.")
    expected: int = Field(
        description="Participants expected: from their first day until they left."
    )
    told: int = Field(description="Expected participants with a meal or a closed day.")
    told_closed: int = Field(description="Expected participants with a closed day.")
    told_open: int = Field(description="Expected participants with a meal whose day is not closed.")
    silent: int = Field(description="Expected participants without a meal whose day is not closed.")
    with_meal: int = Field(description="Participants with at least one meal.")
    closed: int = Field(description="Participants whose day is closed.")
    ate_nothing: int = Field(
        description="Participants whose day is closed with the entry that nothing was eaten, and has no meal."
    )
    whole: int = Field(description=WHOLE)
    whole_energy_kcal: float | None = Field(
        description="Mean energy of the whole days; null: there is none."
    )
    open_days: int = Field(description="Days that are not closed, with some energy known.")
    open_energy_kcal: float | None = Field(
        description="Mean energy of the open days: a lower bound."
    )
    meals: int = Field(description="Meals of the day.")
    receiving_meals: int = Field(description="Meals of status receiving.")
    queued_meals: int = Field(description="Meals of status queued.")
    processing_meals: int = Field(description="Meals of status processing.")
    estimated_meals: int = Field(description="Meals of status estimated.")
    needs_review_meals: int = Field(description="Meals of status needs_review.")
    failed_meals: int = Field(description="Meals of status failed.")
    confirmed_meals: int = Field(description="Meals of status confirmed.")
    late_meals: int = Field(description=LATE)
    late_share: float | None = Field(description="Share of late meals; null without meals.")
    median_delay_seconds: float | None = Field(
        description="From eating to arrival, of the day's meals."
    )
    located_meals: int = Field(description="Meals whose place is kept.")
    unmeasured_meals: int = Field(description=UNMEASURED_MEALS)
    items: int = Field(description="Items that count (not rejected).")
    unmeasured_items: int = Field(description="Items whose eaten grams are unknown.")
    provisional_items: int = Field(description="Items that an after-meal pair may still change.")


class OverviewStatusOut(BaseModel):
    """Meals of a status, that need a look, or whose after-meal pair is pending or has failed."""

    status: CountedStatus = Field(
        description="A meal's status, or needs_look (counted up to 1,000), after_awaited or after_failed."
    )
    meals: int = Field(description="How many meals there are.")


class FailureCountOut(BaseModel):
    """Meals that failed with one code."""

    failure_code: str = Field(description="Why the meals could not be measured (docs/errors.md).")
    meals: int = Field(description="How many meals there are.")


def _rows(name: str) -> BeforeValidator:
    """Let a mapping of counts validate as a list of rows: {name: key, meals: count}."""
    return BeforeValidator(
        lambda counts: [{name: key, "meals": meals} for key, meals in counts.items()]
    )


StatusCounts = Annotated[list[OverviewStatusOut], _rows("status")]
FailureCounts = Annotated[list[FailureCountOut], _rows("failure_code")]


class BinOut(BaseModel):
    """Whole days whose amount lies in [from, to); the last bin includes its end."""

    component: str = Field(
        description="The record's column, such as energy_kcal: its unit is in its name."
    )
    from_amount: float = Field(description="Lower end of the bin, included.")
    to_amount: float = Field(description="Upper end of the bin, included in the last one only.")
    days: int = Field(description="Whole days whose amount lies in the bin.")


class OverviewNutrientOut(BaseModel):
    """The distribution of an amount over whole participant-days on which all of it is known."""

    component: str = Field(
        description="The record's column, such as energy_kcal: its unit is in its name."
    )
    days: int = Field(description="Whole participant-days on which all of it is known.")
    mean: float | None = Field(description="Mean over the days; null: there are none.")
    sd: float | None = Field(
        description="Sample standard deviation of the days; null for fewer than two."
    )
    sd_between_persons: float | None = Field(
        description="The same of the participants' means over these days; null for fewer than two."
    )
    median: float | None = Field(description="Median of the days; null: there are none.")
    minimum: float | None = Field(description="Least amount of a day; null: there are none.")
    maximum: float | None = Field(description="Greatest amount of a day; null: there are none.")
    days_below_bins: int = Field(description="Days below the histogram's first bin.")
    days_above_bins: int = Field(description="Days above the histogram's last bin.")


class PersonDayOut(BaseModel):
    """A participant's day that was expected, or has a meal or a diary entry."""

    participant: ParticipantCode
    local_date: date = Field(description="The participant's local day.")
    expected: bool = Field(
        description="Whether the day lies between their first day and the day on which they left."
    )
    closed: bool = Field(description="Whether the day is closed.")
    meals: int = Field(description="Meals of the day.")


class PlaceOut(BaseModel):
    """Where a meal was eaten, WGS84, rounded to three decimals of a degree."""

    meal_id: uuid.UUID = Field(description=MEAL_ID)
    participant: ParticipantCode
    captured_at: CapturedAt
    local_date: LocalDate
    latitude: float = Field(description="Degrees north, WGS84.")
    longitude: float = Field(description="Degrees east, WGS84.")


class OverviewOut(BaseModel):
    """A study over a window of local days, both ends included."""

    study: str = Field(description=STUDY)
    first_day: date = Field(description="First local day of the window, included.")
    last_day: date = Field(description="Last local day of the window, included.")
    participants: OverviewPeopleOut = Field(description="How many participants there are.")
    completeness: CompletenessOut = Field(description="How complete the window's diary is.")
    days: list[OverviewDayOut] = Field(description="One entry per local day of the window.")
    statuses: StatusCounts = Field(description="The window's meals by status.")
    waiting: StatusCounts = Field(description="Meals of the whole study that wait now, by status.")
    failures: FailureCounts = Field(
        description="Failed meals of the whole study, now, by code; the most frequent first."
    )
    nutrients: list[OverviewNutrientOut] = Field(
        description="How the amounts of each component are distributed over whole days."
    )
    histograms: list[BinOut] = Field(description="Bins of each component, in order.")
    person_days: list[PersonDayOut] = Field(
        description="By participant and day; empty for more than 60 participants, or more than 35 days."
    )
    located_meals: int | None = Field(
        description="Meals of the window whose place is kept; null: the study keeps no places."
    )
    places: list[PlaceOut] = Field(description="The newest 2,000 places of the window's meals.")
