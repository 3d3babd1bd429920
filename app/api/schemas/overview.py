"""A study's overview over the wire; each list is a table that can be had as CSV with the same rows."""

import uuid
from datetime import date, datetime

from pydantic import BaseModel, Field

from app.api.schemas.days import UNMEASURED_MEALS

WHOLE = "Closed, and everything eaten is measured and final, or nothing was eaten; with all of its energy known."
LATE = "Arrived more than 24 hours after they were eaten."


class OverviewPeopleOut(BaseModel):
    """Participants."""

    everybody: int = Field(description="Those who have left included.")
    active: int = Field(description="With a meal in the window.")
    withdrawn: int = Field(description="Those who have left, whatever became of their data.")
    erased: int = Field(description="Of those: whose data were erased, of whom this count is all that is left.")


class CompletenessOut(BaseModel):
    """Participant-days of the window."""

    expected: int = Field(description="From each participant's first day until they left, today at the latest.")
    told: int = Field(description="Of those: with a meal, or closed.")
    silent: int = Field(description="Of those: without.")
    closed: int
    whole: int = Field(description=WHOLE)
    meals: int
    late_meals: int = Field(description=LATE)
    median_delay_seconds: float | None = Field(description="From eating to the server, of the window's meals.")


class OverviewDayOut(BaseModel):
    """A local day of the window; numbers of participants, but for what names meals or items."""

    local_date: date
    expected: int
    told: int
    told_closed: int = Field(description="Of those who were expected.")
    told_open: int = Field(description="Of those who were expected: with a meal, and not closed.")
    silent: int
    with_meal: int
    closed: int
    ate_nothing: int
    whole: int = Field(description=WHOLE)
    whole_energy_kcal: float | None = Field(description="Mean of the whole days; null: there is none.")
    open_days: int = Field(description="Not closed, with some energy known.")
    open_energy_kcal: float | None = Field(description="Mean of the open days: a lower bound, more may come.")
    meals: int
    receiving_meals: int
    queued_meals: int
    processing_meals: int
    estimated_meals: int
    needs_review_meals: int
    failed_meals: int
    confirmed_meals: int
    late_meals: int = Field(description=LATE)
    late_share: float | None = Field(description="Of the meals; null where there is none.")
    median_delay_seconds: float | None = Field(description="From eating to the server, of the day's meals.")
    located_meals: int = Field(description="Whose place is kept.")
    unmeasured_meals: int = Field(description=UNMEASURED_MEALS)
    items: int
    unmeasured_items: int
    provisional_items: int


class OverviewStatusOut(BaseModel):
    """Meals of a status, or whose after-meal pair is waited for (after_awaited) or has failed (after_failed)."""

    status: str
    meals: int


class FailureCountOut(BaseModel):
    """Meals that failed by a code."""

    failure_code: str
    meals: int


class BinOut(BaseModel):
    """Whole days whose amount lies in [from, to); in the last bin also those at its end."""

    component: str = Field(description="The record's column, such as energy_kcal: its unit is in its name.")
    from_amount: float
    to_amount: float
    days: int


class OverviewNutrientOut(BaseModel):
    """How an amount lies over whole participant-days of which all of it is known."""

    component: str = Field(description="The record's column, such as energy_kcal: its unit is in its name.")
    days: int
    mean: float | None
    sd: float | None = Field(description="The sample's; null of fewer than two days.")
    median: float | None
    minimum: float | None
    maximum: float | None
    days_below_bins: int
    days_above_bins: int


class PersonDayOut(BaseModel):
    """A participant's day, on which something was expected or is known."""

    participant: str
    local_date: date
    expected: bool
    closed: bool
    meals: int


class PlaceOut(BaseModel):
    """Where a meal was eaten, WGS84, rounded to three decimals of a degree."""

    meal_id: uuid.UUID
    participant: str
    captured_at: datetime
    local_date: date
    latitude: float
    longitude: float


class OverviewOut(BaseModel):
    """A study over a window of local days, both ends included."""

    study: str
    first_day: date
    last_day: date
    participants: OverviewPeopleOut
    completeness: CompletenessOut
    days: list[OverviewDayOut]
    statuses: list[OverviewStatusOut] = Field(description="Of the window's meals.")
    waiting: list[OverviewStatusOut] = Field(description="Of the whole study, now.")
    failures: list[FailureCountOut] = Field(description="Of the whole study, now; the commonest first.")
    nutrients: list[OverviewNutrientOut]
    histograms: list[BinOut]
    person_days: list[PersonDayOut] = Field(
        description="By participant and day; empty in a study of more than 60, or a window of more than 35 days."
    )
    located_meals: int | None = Field(description="Null: the study keeps no places.")
    places: list[PlaceOut] = Field(description="Of the newest 2,000 located meals of the window.")
