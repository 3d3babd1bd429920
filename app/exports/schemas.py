"""Schemas of exports in the background."""

import uuid
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.exports.export_spec import Components, ExportSpec, Layout, Rows
from app.exports.models import ExportState
from app.http.closed_model import ClosedModel
from app.http.file_formats import Output
from app.http.page_of import PageOf
from app.http.row_filter import RowFilter
from app.http.text_schemas import LocalDay, Text
from app.meals.stored.models import AfterStatus, MealOrigin, MealStatus
from app.meals.stored.record_models import RecordStatus

Word = Annotated[Text, Field(min_length=1, max_length=100)]
Words = Annotated[list[Word], Field(max_length=10)]
Statuses = Annotated[list[Literal[RecordStatus, MealStatus]], Field(max_length=10)]
AfterStatuses = Annotated[list[AfterStatus], Field(max_length=10)]


class ExportFiltersIn(ClosedModel):
    """Which rows, as the parameters of the table's JSON pages; days are local, both included."""

    model_config = ConfigDict(populate_by_name=True)

    participant: Annotated[Text, Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="Only this participant's rows."
    )
    first_day: LocalDay | None = Field(
        default=None, alias="from", description="First local day, included."
    )
    last_day: LocalDay | None = Field(
        default=None, alias="to", description="Last local day, included."
    )
    food: Words = Field(default=[], description="Keys of foods; any of several.")
    status: Statuses = Field(
        default=[],
        description="Statuses, of the item or of the meal, depending on the rows; any of several.",
    )
    flag: Words = Field(
        default=[], description="Only meals with an item that has this flag; any of several."
    )
    origin: MealOrigin | None = Field(default=None, description="Only meals of this origin.")
    needs: Literal["review", "answer"] | None = Field(
        default=None,
        description="review: an item is in the review queue. answer: a question to the participant is open.",
    )
    failure: Words = Field(
        default=[], description="Only meals that failed with this code; any of several."
    )
    after_status: AfterStatuses = Field(
        default=[], description="The after-meal pair's status; any of several."
    )

    def as_filter(self, study: str | None = None) -> RowFilter:
        """Return the filter of these values."""
        return RowFilter(
            study,
            self.participant,
            self.first_day,
            self.last_day,
            food_keys=tuple(self.food),
            statuses=tuple(self.status),
            flags=tuple(self.flag),
            origin=self.origin,
            needs=self.needs,
            failure_codes=tuple(self.failure),
            after_statuses=tuple(self.after_status),
        )


class ExportIn(ClosedModel):
    """A request for a file."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {
                "rows": "items",
                "layout": "wide",
                "format": "parquet",
                "components": "all",
                "filters": {
                    "from": "2026-11-01",
                    "to": "2026-11-30",
                    "status": ["confirmed", "corrected"],
                },
            }
        },
    )

    rows: Rows = Field(description="The table.")
    layout: Layout = Field(
        default="wide", description="wide: one column per component. long: one row per component."
    )
    format: Output = Field(
        default="csv", description="The file's format; geojson has meals with a kept location only."
    )
    components: Components = Field(
        default="headline",
        description="headline: the ten components of every record. all: every component of the foods in use as well.",
    )
    provenance: bool = Field(
        default=True, description="Of items and meals: columns with the sources of the figures."
    )
    filters: ExportFiltersIn = Field(
        default=ExportFiltersIn(), description="Which rows; by default all of the study's."
    )

    def as_spec(self, study: str | None = None) -> ExportSpec:
        """Return the requested table."""
        filters = self.filters.as_filter(study)
        return ExportSpec(
            self.rows, self.layout, self.format, self.components, filters, self.provenance
        )


class ExportOut(BaseModel):
    """An export and its progress; its file is available while it is done, until expires_at."""

    id: uuid.UUID = Field(description="The export's id.")
    state: ExportState = Field(description="Its state; expired: its file is deleted.")
    rows: Rows = Field(description="The table.")
    layout: Layout = Field(
        description="wide: one column per component. long: one row per component."
    )
    format: Output = Field(description="The file's format.")
    components: Components = Field(
        description="headline: the ten components of every record. all: every component of the foods in use as well."
    )
    provenance: bool = Field(
        description="Whether the file has columns with the sources of the figures."
    )
    filters: dict[str, Any] = Field(description="The filters that were set.")
    asked_by: str = Field(description="Name of the staff member who requested it.")
    requested_at: datetime = Field(description="When it was requested.")
    started_at: datetime | None = Field(
        description="When a worker started to write it; null: it waits."
    )
    finished_at: datetime | None = Field(
        description="When it was done, failed or cancelled; null: not yet."
    )
    rows_written: int = Field(description="Rows written so far; in the end all.")
    rows_estimated: int | None = Field(
        description="Estimated number of rows; null: unknown, or not started."
    )
    bytes: int = Field(description="Bytes written so far; in the end the file's length.")
    sha256: str | None = Field(description="SHA-256 of the file, hex; null: it is not done.")
    change_seq: int | None = Field(
        description="The study's change counter at the moment of the file's data."
    )
    failure: str | None = Field(description="Why it failed: a code; null: it has not.")
    file: str | None = Field(description="Path of the file; null: there is none.")
    expires_at: datetime | None = Field(
        description="When the file is deleted; null: there is no file."
    )


class ExportList(PageOf[ExportOut]):
    """Exports of a study, the newest first; `next` leads to the page after it, null at the end."""
