"""Query parameters of tables that are offered as files (`format`, `layout`, ...), and the file as a response."""

from dataclasses import replace
from typing import Annotated, Literal

from fastapi import Depends, Query, Request
from pydantic import StringConstraints

from app.core.errors import InvalidInputError
from app.exports.export_file import make_export
from app.exports.export_places import ExportPlaces
from app.exports.export_spec import Components, ExportSpec, Layout, Rows
from app.http.file_formats import FORMATS, OF_PLACES, Output, asked_format
from app.http.paging import require_order
from app.http.parameters import FirstDay, LastDay, OfParticipant, OfStudy
from app.http.problems import Responses, problem_responses
from app.http.ranges import ClosingStream
from app.http.row_filter import RowFilter
from app.http.state import ApiState
from app.meals.stored.models import AfterStatus, MealOrigin, MealStatus
from app.meals.stored.record_models import RecordStatus
from app.people.access.caller import Caller

FILES: dict[str, object] = {
    form.content_type: {"schema": {"type": "string"}}
    for form in FORMATS.values()
    if not form.is_places
}
FILES_WITH_PLACES = FILES | {
    FORMATS[output].content_type: {"schema": {"type": "object"}} for output in OF_PLACES
}
Format = Annotated[
    Literal["json", Output] | None,
    Query(alias="format", description="Default: by the Accept header, else json."),
]
LayoutIn = Annotated[Layout, Query(description="Of files. long: a row a component.")]
ComponentsIn = Annotated[
    Components,
    Query(
        description="Of files. all: every component of the foods in use, beside the ten headline ones."
    ),
]
ProvenanceIn = Annotated[
    bool, Query(description="Of files: with columns that tell where the figures come from.")
]
FoodKey = Annotated[str, StringConstraints(max_length=100)]
Code = Annotated[str, StringConstraints(max_length=64, pattern="^[a-z0-9_]+$")]
MOST_VALUES = 10  # of one filter: each needs its own index lookup


def page_or_file(content: dict[str, object], *problems: int) -> Responses:
    """Return the responses of a list that also is a file. content: media types."""
    answer = {"content": content, "description": "A page, or all rows as a file."}
    return {200: answer, **problem_responses(*problems)}


def stored_file_responses(content: dict[str, object]) -> dict[int | str, dict[str, object]]:
    """Return the successful responses of a route that calls answer_stored_file. content: media type -> schema."""
    return {
        200: {"content": content, "description": "The file."},
        206: {"content": content, "description": "The part that `Range` asks for."},
        304: {"description": "It is what `If-None-Match` names."},
    }


def day_filter(
    study: OfStudy = None,
    participant: OfParticipant = None,
    first_day: FirstDay = None,
    last_day: LastDay = None,
) -> RowFilter:
    """Return the filter of days. Raises InvalidInputError (`days_reversed`)."""
    require_order(first_day, last_day)
    return RowFilter(study, participant, first_day, last_day)


DayFilterIn = Annotated[RowFilter, Depends(day_filter)]


def record_filter(
    chosen: DayFilterIn,
    food: Annotated[
        list[FoodKey] | None,
        Query(max_length=MOST_VALUES, description="A food's key; any of several."),
    ] = None,
    status: Annotated[
        list[RecordStatus] | None,
        Query(max_length=5, description="The items' status; any of several."),
    ] = None,
) -> RowFilter:
    """Return the filter of records."""
    return replace(chosen, food_keys=tuple(food or ()), statuses=tuple(status or ()))


def meal_filter(
    chosen: DayFilterIn,
    status: Annotated[
        list[MealStatus] | None,
        Query(max_length=7, description="The meals' status; any of several."),
    ] = None,
    origin: Annotated[
        MealOrigin | None,
        Query(description="Whether the meal was photographed, or declared without photographs."),
    ] = None,
    failure: Annotated[
        list[Code] | None,
        Query(max_length=MOST_VALUES, description="A failure's code; any of several."),
    ] = None,
    after_status: Annotated[
        list[AfterStatus] | None,
        Query(max_length=7, description="How the after-meal pair stands; any of several."),
    ] = None,
    food: Annotated[
        list[FoodKey] | None,
        Query(max_length=MOST_VALUES, description="The key of a food of an item; any of several."),
    ] = None,
    flag: Annotated[
        list[Code] | None,
        Query(max_length=MOST_VALUES, description="A flag of an item; any of several."),
    ] = None,
    needs: Annotated[
        Literal["review", "answer"] | None,
        Query(
            description="review: an item is in the review queue; answer: a question to the participant is open."
        ),
    ] = None,
) -> RowFilter:
    """Return the filter of meals."""
    return replace(
        chosen,
        food_keys=tuple(food or ()),
        statuses=tuple(status or ()),
        flags=tuple(flag or ()),
        origin=origin,
        needs=needs,
        failure_codes=tuple(failure or ()),
        after_statuses=tuple(after_status or ()),
    )


def file_spec(
    request: Request,
    rows: Rows,
    filters: RowFilter,
    output: str | None,
    layout: Layout = "wide",
    components: Components = "headline",
    *,
    provenance: bool = True,
) -> ExportSpec | None:
    """Return the requested file, by the parameter or else by the Accept header; None: pages of JSON.

    Raises InvalidInputError (`export_not_offered`) for pages in another layout.
    """
    asked = asked_format(request, output, FORMATS)
    if asked is not None:
        return ExportSpec(rows, layout, asked, components, filters, provenance)
    if layout != "wide" or components != "headline":
        raise InvalidInputError(
            "layout and components are of files: add format=csv, ndjson or parquet.",
            code="export_not_offered",
        )
    return None


def answer_file(state: ApiState, caller: Caller, spec: ExportSpec) -> ClosingStream:
    """Return the file as a download. Raises as make_export."""
    places = state.part(ExportPlaces)
    file = make_export(state.database, state.blobs, state.settings, places, caller, spec)
    headers = {
        "Content-Disposition": f'attachment; filename="{spec.file_name}"',
        "Content-Length": str(file.length),
    }
    media_type = FORMATS[spec.output].media_type
    return ClosingStream(file.pieces, file.close, media_type=media_type, headers=headers)
