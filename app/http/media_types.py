"""The formats of tables that leave, and their media types."""

from typing import Literal

Output = Literal["csv", "ndjson", "parquet", "geojson"]
MEDIA_TYPES: dict[Output, str] = {
    "csv": "text/csv; charset=utf-8; header=present",
    "ndjson": "application/x-ndjson",
    "parquet": "application/vnd.apache.parquet",
    "geojson": "application/geo+json",
}


def file_name(output: str, *parts: object) -> str:
    """Return a file's name by its parts that are not None: pilot_meals_2026-11-01_2026-11-28.csv."""
    return "_".join(str(part) for part in parts if part is not None) + f".{output}"


def attachment(output: str, *parts: object) -> dict[str, str]:
    """Return the header that saves a file by the name that its parts make."""
    return {"Content-Disposition": f'attachment; filename="{file_name(output, *parts)}"'}
