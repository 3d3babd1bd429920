"""Exports in the background over the wire."""

import uuid
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas.text import LocalDay, Text
from app.services.export_spec import Components, Layout, Output, Rows

Word = Annotated[Text, Field(min_length=1, max_length=100)]
Words = Annotated[list[Word], Field(max_length=10)]
ExportState = Literal["queued", "running", "done", "failed", "cancelled", "expired"]


class ExportFiltersIn(BaseModel):
    """Which rows, as the parameters of the table's JSON pages; days are local, both included."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    participant: Annotated[Text, Field(min_length=1, max_length=64)] | None = None
    first_day: LocalDay | None = Field(default=None, alias="from")
    last_day: LocalDay | None = Field(default=None, alias="to")
    food: Words = []
    status: Words = []
    flag: Words = []
    origin: Word | None = None
    needs: Word | None = None
    failure: Words = []
    after_status: Words = []


class ExportIn(BaseModel):
    """A file that is wanted."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "rows": "items",
                "layout": "wide",
                "format": "parquet",
                "components": "all",
                "filters": {"from": "2026-11-01", "to": "2026-11-30", "status": ["confirmed", "corrected"]},
            }
        },
    )

    rows: Rows
    layout: Layout = "wide"
    format: Output = "csv"
    components: Components = "headline"
    provenance: bool = Field(default=True, description="Of items and meals: columns of where figures come from.")
    filters: ExportFiltersIn = ExportFiltersIn()


class ExportOut(BaseModel):
    """How far an export is; its file is there while it is done, until expires_at."""

    id: uuid.UUID
    state: ExportState
    rows: Rows
    layout: Layout
    format: Output
    components: Components
    provenance: bool
    filters: dict[str, Any] = Field(description="Those that were set.")
    asked_by: str
    requested_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    rows_written: int = Field(description="So far; of a file that is done, all.")
    rows_estimated: int | None = Field(description="Null: not known, or not begun.")
    bytes: int = Field(description="So far; of a file that is done, its length.")
    sha256: str | None
    change_seq: int | None = Field(description="The study's counter of changes at the moment that the file is of.")
    failure: str | None = Field(description="Why it failed: a code.")
    file: str | None = Field(description="Path of the file; null where there is none.")
    expires_at: datetime | None


class ExportList(BaseModel):
    """Exports of a study, the newest first; `next` leads to the page after it, null at the end."""

    items: list[ExportOut]
    next: str | None
