"""What every table that is a file too takes (`format`, `layout`, `components`), and the file as an answer."""

from typing import Annotated, Any, Literal

from fastapi import Query, Request

from app.core.errors import InvalidInputError
from app.exports.export_file import ExportFile
from app.exports.export_spec import Components, ExportSpec, Layout, Output
from app.http.closing_stream import ClosingStream
from app.http.state import ApiState
from app.people.access.caller import Caller
from app.privacy.export_me import ExportPlaces

MEDIA_TYPES: dict[Output, str] = {
    "csv": "text/csv; charset=utf-8; header=present",
    "ndjson": "application/x-ndjson",
    "parquet": "application/vnd.apache.parquet",
    "geojson": "application/geo+json",
}
FILES: dict[str, dict[str, Any]] = {
    media_type.split(";")[0]: {"schema": {"type": "string"}}
    for output, media_type in MEDIA_TYPES.items()
    if output != "geojson"
}
FILES_WITH_PLACES = FILES | {MEDIA_TYPES["geojson"]: {"schema": {"type": "object"}}}
Format = Annotated[
    Literal["json", "csv", "ndjson", "parquet", "geojson"] | None,
    Query(alias="format", description="Default: by the Accept header, else json."),
]
LayoutIn = Annotated[Layout, Query(description="Of files. long: a row a component.")]
ComponentsIn = Annotated[
    Components, Query(description="Of files. all: every component of the foods in use, beside the ten headline ones.")
]

ProvenanceIn = Annotated[bool, Query(description="Of files: with columns that tell where the figures come from.")]


def file_format(
    request: Request, output: str | None, layout: Layout = "wide", components: Components = "headline"
) -> Output | None:
    """The file that is asked for, by the parameter or else by the header; None: pages of JSON.

    Raises InvalidInputError (`export_not_offered`) for pages in another layout.
    """
    accept = request.headers.get("accept", "")
    for name, media_type in MEDIA_TYPES.items():
        if output == name or (output is None and accept.startswith(media_type.split(";")[0])):
            return name
    if layout != "wide" or components != "headline":
        raise InvalidInputError(
            "layout and components are of files: add format=csv, ndjson or parquet.", code="export_not_offered"
        )
    return None


def answer_file(state: ApiState, caller: Caller, spec: ExportSpec, name: str) -> ClosingStream:
    """The file, to be saved under this name. Raises what ExportFile raises."""
    file = ExportFile(state.database, state.blobs, state.settings, state.part(ExportPlaces))(caller, spec)
    headers = {
        "Content-Disposition": f'attachment; filename="{name}.{spec.output}"',
    }
    return ClosingStream(file.pieces, file.close, media_type=MEDIA_TYPES[spec.output], headers=headers)
