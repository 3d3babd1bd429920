"""The formats of tables that leave as files, each told here alone.

The same folder lists and limits them, so that they stand below app/exports, which writes them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

from starlette.requests import Request

Output = Literal["csv", "ndjson", "parquet", "geojson"]  # and a file's suffix
JSON = "application/json"


@dataclass(frozen=True, slots=True)
class FileFormat:
    """A format of exported tables.

    title: its name on pages hint: what a form says of it beside its name; empty: nothing
    media_type: with its parameters cells: how a value is written: as text that no spreadsheet
    computes, as in the API's JSON, or in its own type copy_options: of DuckDB's COPY is_places:
    whether a row is a GeoJSON feature at the place of its meal
    """

    title: str
    hint: str
    media_type: str
    cells: Literal["text", "json", "typed"]
    copy_options: str
    is_places: bool = False

    @property
    def content_type(self) -> str:
        """The media type without parameters."""
        return self.media_type.partition(";")[0]


FORMATS: Mapping[Output, FileFormat] = {
    "csv": FileFormat(
        title="CSV",
        hint="",
        media_type="text/csv; charset=utf-8; header=present",
        cells="text",
        copy_options="FORMAT csv, HEADER, NEW_LINE '\\r\\n'",
    ),
    "ndjson": FileFormat(
        title="NDJSON",
        hint="one object per line",
        media_type="application/x-ndjson",
        cells="json",
        copy_options="FORMAT json",
    ),
    "parquet": FileFormat(
        title="Parquet",
        hint="typed, smallest",
        media_type="application/vnd.apache.parquet",
        cells="typed",
        copy_options="FORMAT parquet, COMPRESSION zstd",
    ),
    "geojson": FileFormat(
        title="GeoJSON",
        hint="one feature per row",
        media_type="application/geo+json",
        cells="json",
        copy_options="FORMAT json, ARRAY true",
        is_places=True,
    ),
}
Offered = TypeVar("Offered", bound=Output)
OF_PLACES = tuple(output for output, form in FORMATS.items() if form.is_places)


def asked_format(
    request: Request, output: str | None, offered: Iterable[Offered]
) -> Offered | None:
    """Return the format that is asked for by name, or else by the Accept header; None: no file."""
    accept = request.headers.get("accept", "")
    for name in offered:
        if output == name or (output is None and accept.startswith(FORMATS[name].content_type)):
            return name
    return None


def file_name(output: str, *parts: object) -> str:
    """Return a file's name by its parts that are not None: pilot_meals_2026-11-01_2026-11-28.csv."""
    return "_".join(str(part) for part in parts if part is not None) + f".{output}"


def attachment(output: str, *parts: object) -> dict[str, str]:
    """Return the header that saves a file by the name that its parts make."""
    return {"Content-Disposition": f'attachment; filename="{file_name(output, *parts)}"'}
