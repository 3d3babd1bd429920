"""What a column is: its name, the type and unit of its values, and what it means."""

from dataclasses import dataclass
from typing import Literal

ColumnType = Literal[
    "id", "word", "instant", "local time", "day", "number", "integer", "boolean", "words"
]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    type: a "word" is any text; "words" is a list of texts.
    unit: None where the values have none.
    meaning: one or a few sentences for the data dictionary.
    values: all that there can be, where that is a short list.
    empty: what an empty cell says; None: no cell is empty.
    """

    name: str
    type: ColumnType
    unit: str | None = None
    meaning: str = ""
    values: tuple[str, ...] = ()
    empty: str | None = None
