"""The ten components that a record holds itself, as pages name them."""

from typing import NamedTuple

from app.db.models.record import HEADLINE_COLUMNS


class Headline(NamedTuple):
    """A column of a record, what it is called, and its unit, which stands at the column's end."""

    column: str
    name: str
    unit: str


HEADLINES = tuple(
    Headline(column, column.rpartition("_")[0].replace("_", " ").capitalize(), column.rpartition("_")[2])
    for column in HEADLINE_COLUMNS
)
