"""The ten components that a record holds itself, as pages name them."""

from typing import NamedTuple

from app.meals.record_models import HEADLINE_COLUMNS


class Headline(NamedTuple):
    """A column of a record, what it is called, and its unit, which stands at the column's end."""

    column: str
    name: str
    unit: str


def _name(words: str) -> str:
    return words.replace("_", " ").capitalize().replace("Vitamin c", "Vitamin C")


HEADLINES = tuple(
    Headline(column, _name(column.rpartition("_")[0]), column.rpartition("_")[2]) for column in HEADLINE_COLUMNS
)
