"""Remeasurements and their table as HTTP and the command line give them."""

import hashlib
import json
import uuid
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from app.http.closed_model import ClosedModel
from app.http.field_descriptions import (
    MEAL_ID,
    CapturedAt,
    ParticipantCode,
)
from app.http.page_of import PageOf
from app.meals.stored.job_models import PairPurpose, PairState, RemeasurementState

MOST_MEALS = 1000  # named one by one
MEALS = "Ids of the meals, as the phones made them; none: all meals of the study."
LIMIT = "At most so many meals, the first that were eaten."
INTERVAL = "90 % interval, ml; null: not measured."


@dataclass(frozen=True, slots=True)
class Selection:
    """The meals of a study to measure again. meals: ids made by phones; none: all. limit: only the first meals."""

    meals: frozenset[uuid.UUID] = frozenset()
    limit: int | None = None

    @property
    def digest(self) -> str:
        """SHA-256 by which the same selection is recognised; the ids themselves could outlive an erased meal."""
        named = json.dumps([self.limit, sorted(str(meal) for meal in self.meals)])
        return hashlib.sha256(named.encode()).hexdigest()


class RemeasurementIn(ClosedModel):
    """The meals to measure again; an empty object selects the whole study."""

    model_config = ConfigDict(json_schema_extra={"example": {"limit": 50}})

    meals: Annotated[list[uuid.UUID], Field(max_length=MOST_MEALS)] = Field(
        default=[], description=MEALS
    )
    limit: Annotated[int, Field(ge=1, le=2**31 - 1)] | None = Field(default=None, description=LIMIT)

    def as_selection(self) -> Selection:
        """Return the selection."""
        return Selection(frozenset(self.meals), self.limit)


class RemeasurementOut(BaseModel):
    """A remeasurement and its progress. A pair is of a meal, or of what was left of it."""

    id: uuid.UUID = Field(description="The remeasurement's id.")
    state: RemeasurementState = Field(description="stopped: it can be continued.")
    author: str = Field(description="Who started it.")
    pipeline_version: str = Field(
        description="Version of the pipeline when it was started; each run has its own."
    )
    created_at: datetime = Field(description="When it was started.")
    ended_at: datetime | None = Field(
        description="When it was stopped or done; null: it is running."
    )
    pairs: int = Field(description="Number of its pairs of photographs.")
    waiting: int = Field(description="Pairs that are not measured yet, or are being measured.")
    measured: int = Field(description="Pairs whose records rest on the new run.")
    kept: int = Field(description="Pairs whose records rest on the old run, for one of `reasons`.")
    skipped: int = Field(description="Pairs with nothing to measure, for one of `reasons`.")
    reasons: dict[str, int] = Field(
        description="Number of pairs by the reason why they were kept or skipped."
    )
    items: int = Field(description="Items of measured pairs, compared.")
    items_changed: int = Field(
        description="Items of which a figure differs: volume, interval, grams, or a flag."
    )


class RemeasurementList(PageOf[RemeasurementOut]):
    """Remeasurements of a study, the newest first."""


class RemeasurementPlanOut(BaseModel):
    """The pairs that a remeasurement would measure and skip."""

    pairs: int = Field(description="Number of pairs of photographs.")
    would_measure: int = Field(description="Pairs that would be measured.")
    would_skip: dict[str, int] = Field(
        description="Number of pairs that would be skipped, by reason."
    )


class ComparedItemOut(BaseModel):
    """A pair, and one of its items if it was measured: the pipeline's volumes and the record's grams, old and new."""

    participant: ParticipantCode
    meal_id: uuid.UUID = Field(description=MEAL_ID)
    captured_at: CapturedAt
    pair: PairPurpose = Field(
        description="meal: its own photographs; after: those of what was left."
    )
    state: PairState = Field(description="What became of the pair.")
    reason: str | None = Field(description="Why it was kept or skipped; null: it was not.")
    item_id: uuid.UUID | None = Field(
        description="The item; null: the pair has no items to compare."
    )
    food: str | None = Field(description="Key of the item's food now; null: not known.")
    old_volume_ml: float | None = Field(
        description="Volume of the old run; null: not measured, or it lacked the item."
    )
    old_low_ml: float | None = Field(description=f"Its lower bound. {INTERVAL}")
    old_high_ml: float | None = Field(description=f"Its upper bound. {INTERVAL}")
    new_volume_ml: float | None = Field(
        description="Volume of the new run; null: not measured, or it lacks the item."
    )
    new_low_ml: float | None = Field(description=f"Its lower bound. {INTERVAL}")
    new_high_ml: float | None = Field(description=f"Its upper bound. {INTERVAL}")
    old_mass_g: float | None = Field(
        description="Grams of the record before, with what people said; null: not known."
    )
    new_mass_g: float | None = Field(description="Grams of the record afterwards; null: not known.")
    is_changed: bool | None = Field(
        description="Whether any figure or flag differs; null: there is no item."
    )


class ComparedItemList(PageOf[ComparedItemOut]):
    """The table of old and new volumes, in the order in which the meals were eaten."""
