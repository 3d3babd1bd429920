"""The ten headline components of a record, with their names on pages."""

from typing import NamedTuple

from app.meals.stored.record_models import HEADLINE_COLUMNS


class Headline(NamedTuple):
    """A record's column, its name on pages, and its unit, which is the column's suffix."""

    column: str
    name: str
    unit: str


def _name(words: str) -> str:
    return words.replace("_", " ").capitalize().replace("Vitamin c", "Vitamin C")


HEADLINES = tuple(
    Headline(column, _name(column.rpartition("_")[0]), column.rpartition("_")[2])
    for column in HEADLINE_COLUMNS
)
