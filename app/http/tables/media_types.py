"""The formats of tables that leave, and their media types."""

from typing import Literal

Output = Literal["csv", "ndjson", "parquet", "geojson"]
MEDIA_TYPES: dict[Output, str] = {
    "csv": "text/csv; charset=utf-8; header=present",
    "ndjson": "application/x-ndjson",
    "parquet": "application/vnd.apache.parquet",
    "geojson": "application/geo+json",
}


def attachment(output: str, *parts: object) -> dict[str, str]:
    """Return the header that saves a file by its parts that are not None: pilot_meals_2026-11-01_2026-11-28.csv."""
    name = "_".join(str(part) for part in parts if part is not None)
    return {"Content-Disposition": f'attachment; filename="{name}.{output}"'}
