"""Read the CSV tables that ship in this package."""

import csv
from importlib import resources


def packaged_rows(*path: str) -> list[dict[str, str]]:
    """Return the rows of a CSV file by column. path: below app/nutrition."""
    text = resources.files("app.nutrition").joinpath(*path).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))
