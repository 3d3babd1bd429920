"""Releases over the wire."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas.text import LocalDay, Text

RecordStatus = Literal["proposed", "needs_review", "confirmed", "corrected", "rejected"]
ReleaseState = Literal["queued", "running", "ready", "changing", "failed"]
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$", description="Unique in the study, for ever.")]


class ReleaseIn(BaseModel):
    """What is to be frozen."""

    model_config = ConfigDict(
        extra="forbid",
        populate_by_name=True,
        json_schema_extra={"example": {"name": "2026-baseline", "note": "For the paper", "to": "2026-10-31"}},
    )

    name: Name
    note: Annotated[Text, Field(max_length=2000)] = ""
    first_day: LocalDay | None = Field(default=None, alias="from", description="First local day, included.")
    last_day: LocalDay | None = Field(default=None, alias="to", description="Last local day, included.")
    statuses: Annotated[list[RecordStatus], Field(max_length=5)] = Field(
        default=[], description="Of items, any of these; none: all. With some there is no table of days."
    )


class ReleaseFileOut(BaseModel):
    """A file of a release."""

    name: str
    rows: int | None
    bytes: int
    sha256: str
    path: str


class FormerChecksum(BaseModel):
    """The checksum that a release had until something in it was erased."""

    checksum: str
    until: datetime


class ReleaseOut(BaseModel):
    """A release. Its files are there while it is ready."""

    name: str
    note: str
    state: ReleaseState = Field(description="changing: something in it was erased; its files come again without it.")
    filters: dict[str, Any]
    made_by: str
    requested_at: datetime
    frozen_at: datetime | None = Field(description="The moment that the data are of.")
    change_seq: int | None = Field(description="The study's counter of changes at that moment.")
    checksum: str | None = Field(description="SHA-256 over the sorted lines `sha256  name` of all but release.json.")
    altered_at: datetime | None = Field(description="When something was last taken out since it was erased.")
    former_checksums: list[FormerChecksum]
    rows: int = Field(description="Of all its tables.")
    bytes: int
    failure: str | None
    files: list[ReleaseFileOut]


class ReleaseList(BaseModel):
    """Releases of a study, the newest first; `next` leads to the page after it, null at the end."""

    items: list[ReleaseOut]
    next: str | None


class CheckedFileOut(BaseModel):
    """A file, compared with what was frozen."""

    name: str
    sha256: str
    found: Literal["whole", "damaged", "missing"]


class ReleaseCheckOut(BaseModel):
    """Whether all files are what was frozen, read back byte for byte."""

    is_whole: bool
    checksum: str | None = Field(description="Of what the store has; null where a file lacks.")
    files: list[CheckedFileOut]
