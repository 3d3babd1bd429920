"""Schemas of a study's changes."""

import uuid
from datetime import date
from typing import Literal

from pydantic import BaseModel, Field

from app.http.field_descriptions import CHANGE_SEQ, PARTICIPANT
from app.meals.day_models import DayStatus
from app.records.schemas import RecordOfItem


class ChangedDayOut(BaseModel):
    """How a participant's day stands."""

    id: uuid.UUID = Field(description="The day's id: a row that changes again comes again with it.")
    participant: str = Field(description=PARTICIPANT)
    local_date: date = Field(description="The participant's local day.")
    status: DayStatus = Field(description="closed: all that was eaten on the day is recorded. open: not so.")
    ate_nothing: bool = Field(description="The word as it was said: a meal on that day says more (GET /v1/days).")
    change_seq: int = Field(description=CHANGE_SEQ)


class ErasedOut(BaseModel):
    """A record or a day that is erased for good: delete yours of this digest."""

    kind: Literal["record", "day"] = Field(description="What was erased: a record of an item, or a participant's day.")
    id_sha256: str = Field(description="SHA-256, hex, of its id as text (lower case, with dashes).")
    change_seq: int = Field(description=CHANGE_SEQ)


class ChangePage(BaseModel):
    """Changes in their order. Keep rows by `id`: one that changes again comes again. Follow `next` whenever you ask."""

    records: list[RecordOfItem] = Field(description="Records that are new or have changed, each as it stands now.")
    days: list[ChangedDayOut] = Field(description="Days that are new or have changed, each as it stands now.")
    erased: list[ErasedOut] = Field(description="Records and days that were erased: delete your copies.")
    next: str = Field(description="Path and query of what comes behind these; empty pages until something changes.")
    has_more: bool = Field(description="Whether there is more now.")
