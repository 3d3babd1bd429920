"""Schemas of a study's changes."""

import uuid
from datetime import date
from typing import Literal

from pydantic import BaseModel, Field

from app.http.field_descriptions import CHANGE_SEQ, ParticipantCode
from app.meals.stored.event_models import DayStatus
from app.records.schemas import RecordOfItem


class ChangedDayOut(BaseModel):
    """The state of a participant's day."""

    id: uuid.UUID = Field(description="The day's id; a row that changes again has the same id.")
    participant: ParticipantCode
    local_date: date = Field(description="The participant's local day.")
    status: DayStatus = Field(
        description="closed: everything eaten on the day is recorded. open: not yet."
    )
    ate_nothing: bool = Field(
        description="As stated: nothing was eaten. A meal on that day overrides it (GET /v1/days)."
    )
    change_seq: int = Field(description=CHANGE_SEQ)


class ErasedOut(BaseModel):
    """A record or a day that was erased for good: delete your copy with this digest."""

    kind: Literal["record", "day"] = Field(
        description="What was erased: a record of an item, or a participant's day."
    )
    id_sha256: str = Field(description="SHA-256, hex, of its id as text (lower case, with dashes).")
    change_seq: int = Field(description=CHANGE_SEQ)


class ChangePage(BaseModel):
    """Changes in their order. Store rows by `id`: a row that changes again is sent again. Continue with `next`."""

    records: list[RecordOfItem] = Field(
        description="New and changed records, in their current state."
    )
    days: list[ChangedDayOut] = Field(description="New and changed days, in their current state.")
    erased: list[ErasedOut] = Field(
        description="Records and days that were erased: delete your copies."
    )
    next: str = Field(
        description="Path and query of the changes after these; empty pages until something changes."
    )
    has_more: bool = Field(description="Whether there are more changes now.")
