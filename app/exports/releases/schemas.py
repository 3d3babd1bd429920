"""Schemas of releases."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.exports.release_models import ReleaseState
from app.exports.releases.release_filters import ReleaseFilters
from app.http.closed_model import ClosedModel
from app.http.field_descriptions import FILTERS
from app.http.page_of import PageOf
from app.http.text_schemas import LocalDay, Text
from app.meals.stored.record_models import RecordStatus

Name = Annotated[
    str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$", description="Unique in the study, for ever.")
]


class ReleaseIn(ClosedModel):
    """A request for a release."""

    model_config = ConfigDict(
        populate_by_name=True,
        json_schema_extra={
            "example": {"name": "2026-baseline", "note": "For the paper", "to": "2026-10-31"}
        },
    )

    name: Name
    note: Annotated[Text, Field(max_length=2000)] = Field(
        default="", description="What the release is for, for people."
    )
    first_day: LocalDay | None = Field(
        default=None, alias="from", description="First local day, included."
    )
    last_day: LocalDay | None = Field(
        default=None, alias="to", description="Last local day, included."
    )
    statuses: Annotated[list[RecordStatus], Field(max_length=5)] = Field(
        default=[],
        description="Statuses of items, any of them; none: all. With a selection there is no table of days.",
    )

    def as_filters(self) -> ReleaseFilters:
        """Return the filters, each status once."""
        return ReleaseFilters(self.first_day, self.last_day, tuple(sorted(set(self.statuses))))


class ReleaseFileOut(BaseModel):
    """A file of a release."""

    name: str = Field(description="The file's name in the release.")
    rows: int | None = Field(description="Number of rows; null: it is no table.")
    bytes: int = Field(description="Length, bytes.")
    sha256: str = Field(description="SHA-256 of the file, hex.")
    path: str = Field(description="Path of its content.")


class FormerChecksum(BaseModel):
    """The checksum that a release had until something in it was erased."""

    checksum: str = Field(description="The former checksum.")
    until: datetime = Field(description="Until when it was valid.")


class ReleaseOut(BaseModel):
    """A release. Its files are available while it is ready."""

    name: str = Field(description="The release's name, unique in the study.")
    note: str = Field(description="What the release is for, for people.")
    state: ReleaseState = Field(
        description="changing: something in it was erased; its files are being rewritten."
    )
    filters: dict[str, Any] = Field(description=FILTERS)
    made_by: str = Field(description="Name of the staff member who requested it.")
    requested_at: datetime = Field(description="When it was requested.")
    frozen_at: datetime | None = Field(description="The moment of its data.")
    change_seq: int | None = Field(description="The study's change counter at that moment.")
    checksum: str | None = Field(
        description="SHA-256 over the sorted lines `sha256  name` of all but datapackage.json."
    )
    altered_at: datetime | None = Field(
        description="When erased data were last removed; null: never."
    )
    former_checksums: list[FormerChecksum] = Field(
        description="Checksums before erased data were removed, the oldest first."
    )
    rows: int = Field(description="Rows of all its tables.")
    bytes: int = Field(description="Length of all its files together, bytes.")
    failure: str | None = Field(description="Why it failed: a code; null: it has not.")
    files: list[ReleaseFileOut] = Field(description="Its files; empty if it is not ready.")


class ReleaseList(PageOf[ReleaseOut]):
    """Releases of a study, the newest first; `next` leads to the page after it, null at the end."""


class CheckedFileOut(BaseModel):
    """A file, compared with what was frozen."""

    name: str = Field(description="The file's name in the release.")
    sha256: str = Field(description="SHA-256 as frozen, hex.")
    found: Literal["whole", "damaged", "missing"] = Field(
        description="The file in the store: the same bytes, other bytes, or missing."
    )


class ReleaseCheckOut(BaseModel):
    """Whether all files are what was frozen, read back byte for byte."""

    is_whole: bool = Field(description="Whether every file is what was frozen.")
    checksum: str | None = Field(
        description="Checksum of the files in the store; null: some are missing."
    )
    files: list[CheckedFileOut] = Field(description="The result for each file.")
