"""The formats of tables that leave, and their media types."""

from typing import Literal

Output = Literal["csv", "ndjson", "parquet", "geojson"]
MEDIA_TYPES: dict[Output, str] = {
    "csv": "text/csv; charset=utf-8; header=present",
    "ndjson": "application/x-ndjson",
    "parquet": "application/vnd.apache.parquet",
    "geojson": "application/geo+json",
}
