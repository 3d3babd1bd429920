"""HTTP schemas of who is behind, and of a study's flow."""

from datetime import date, datetime
from typing import Literal

from pydantic import BaseModel, Field

from app.diary.schemas import PlausibilityOut
from app.people.schemas import ParticipantRow

Stage = Literal["withdrawn", "excluded", "not_enrolled", "too_few_days", "analysed"]


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
        """Whether anything is expected of them."""
        return self.withdrawn_at is None and self.excluded is None


class ProgressOut(BaseModel):
    """A study's participants and how far they are."""

    first_day: date = Field(description="First local day of the window.")
    last_day: date = Field(description="Last local day of the window.")
    items: list[ProgressRowOut] = Field(description="One per participant that was chosen.")
