"""HTTP schemas of how far participants are, and of a study's flow."""

from dataclasses import dataclass
from datetime import date, datetime
from typing import Annotated, Literal

from fastapi import Depends, Query
from pydantic import BaseModel, Field

from app.diary.schemas import PlausibilityOut
from app.http.parameters import FirstDay, LastDay
from app.people.schemas import ARM, ParticipantRow

Order = Literal[
    "last_entry", "participant", "complete", "questions", "unmeasured", "seen", "energy"
]
Stage = Literal["not_enrolled", "withdrawn", "excluded", "too_few_days", "analysed"]


@dataclass(frozen=True, slots=True)
class ProgressFilter:
    """Which participants, in which order, and the days to count: by default the 28 up to yesterday (UTC)."""

    participants: Annotated[
        list[str] | None,
        Query(
            alias="participant",
            max_length=500,
            description="Only this participant, by code; any of several.",
        ),
    ] = None
    arm: Annotated[str, Query(max_length=64, description="Only of this arm.")] = ""
    visit: Annotated[str, Query(max_length=64, description="Only at this visit.")] = ""
    order: Annotated[
        Order, Query(description="Those who are most behind first; participant: by code.")
    ] = "last_entry"
    first_day: FirstDay = None
    last_day: LastDay = None


ProgressFilterIn = Annotated[ProgressFilter, Depends()]


class ProgressRowOut(ParticipantRow):
    """How far a participant is. Days are of the window; questions, meals and phones are of now."""

    enrolled_at: datetime | None = Field(
        description="When the first phone was enrolled; null: none was."
    )
    last_entry: date | None = Field(
        description="The last local day with a meal or closed; null: there is none."
    )
    expected_days: int = Field(
        description="From their first day until they left, or the window's end."
    )
    complete_days: int = Field(
        description="Expected days that are closed, with all eaten grams known and final."
    )
    open_days: list[date] = Field(description="Days with a meal that are not closed.")
    open_questions: int = Field(description="Meals with a question that they have not answered.")
    failed_meals: int = Field(description="Meals that could not be measured.")
    waiting_meals: int = Field(description="Meals that wait for photographs or for their estimate.")
    phone_seen_at: datetime | None = Field(
        description="When a phone of theirs was last used; null: never."
    )
    plausibility: PlausibilityOut = Field(
        description="Of the mean energy of the window's complete days."
    )

    @property
    def is_in(self) -> bool:
        """Return whether anything is expected of them."""
        return self.withdrawn_at is None and self.excluded is None


class ProgressOut(BaseModel):
    """A study's participants and how far they are."""

    first_day: date = Field(description="First local day of the window.")
    last_day: date = Field(description="Last local day of the window.")
    items: list[ProgressRowOut] = Field(description="One per participant that was chosen.")


class FlowRowOut(BaseModel):
    """Participants of one arm at one stage."""

    stage: Stage = Field(
        description="The first that holds, in this order; not_enrolled: no phone ever was."
    )
    reason: str | None = Field(
        description="Why they are excluded, of those not enrolled or excluded; null: none was set."
    )
    arm: str | None = Field(description=ARM)
    participants: int = Field(description="Number of participants; erased ones have no arm.")


class FlowOut(BaseModel):
    """Where a study's participants stand; each is counted in one row."""

    items: list[FlowRowOut] = Field(description="By stage, reason and arm.")
