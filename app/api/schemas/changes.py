"""What has changed in a study, over the wire."""

from datetime import date

from pydantic import BaseModel, Field

from app.api.schemas.records import RecordOut


class ChangedDayOut(BaseModel):
    """How a participant's day stands."""

    participant: str
    local_date: date
    status: str
    ate_nothing: bool = Field(description="The word as it was said: a meal on that day says more (GET /v1/days).")
    change_seq: int


class ErasedRecordOut(BaseModel):
    """A record that is erased for good: delete yours of this digest."""

    id_sha256: str = Field(description="SHA-256, hex, of the record's id as text (lower case, with dashes).")
    change_seq: int


class ChangePage(BaseModel):
    """Changes in their order; a row that changes again comes again. Follow `next` now or whenever you ask again."""

    records: list[RecordOut]
    days: list[ChangedDayOut]
    erased: list[ErasedRecordOut]
    next: str = Field(description="Path and query of what comes behind these; empty pages until something changes.")
    has_more: bool = Field(description="Whether there is more now.")
