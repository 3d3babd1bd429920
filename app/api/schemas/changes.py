"""What has changed in a study, over the wire."""

import uuid
from datetime import date
from typing import Literal

from pydantic import BaseModel, Field

from app.api.schemas.records import RecordOfItem


class ChangedDayOut(BaseModel):
    """How a participant's day stands."""

    id: uuid.UUID
    participant: str
    local_date: date
    status: str
    ate_nothing: bool = Field(description="The word as it was said: a meal on that day says more (GET /v1/days).")
    change_seq: int


class ErasedOut(BaseModel):
    """A record or a day that is erased for good: delete yours of this digest."""

    kind: Literal["record", "day"]
    id_sha256: str = Field(description="SHA-256, hex, of its id as text (lower case, with dashes).")
    change_seq: int


class ChangePage(BaseModel):
    """Changes in their order. Keep rows by `id`: one that changes again comes again. Follow `next` whenever you ask."""

    records: list[RecordOfItem]
    days: list[ChangedDayOut]
    erased: list[ErasedOut]
    next: str = Field(description="Path and query of what comes behind these; empty pages until something changes.")
    has_more: bool = Field(description="Whether there is more now.")
