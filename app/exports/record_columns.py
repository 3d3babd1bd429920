"""The columns of exported records, in their order: those of the API's record, its food as key and name.

They come in parts: columns that stand side by side and come from one place. Of a "shared" part many rows have the same
values (those of one meal, one food ...), so that whoever writes them does it once for all of these rows; of "numbers"
every row has its own, and nothing else; an "id" is a row's own text.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

ColumnType = Literal["id", "word", "instant", "day", "number", "integer", "boolean", "words"]
PartType = Literal["id", "shared", "numbers"]


@dataclass(frozen=True, slots=True)
class Column:
    """A column. type: a "word" is any text, of which there are few. unit: None where the values have none."""

    name: str
    type: ColumnType
    unit: str | None = None


@dataclass(frozen=True, slots=True)
class Part:
    """Columns side by side that come from one place."""

    type: PartType
    columns: tuple[Column, ...]


@dataclass(frozen=True, slots=True)
class PartOfBatch:
    """Some rows of a part: a tuple of values a row, in the order of the columns; of a single column the value itself.

    Values are text, float, int, bool, None, and a tuple of texts for "words"; instants and days are RFC 3339 text, as
    JSON has them. What a shared part has can be hashed.
    """

    part: Part
    rows: Sequence[Any]

    def as_tuples(self) -> Iterable[tuple[Any, ...]]:
        """The rows as tuples, whatever the number of columns."""
        return self.rows if len(self.part.columns) > 1 else zip(self.rows, strict=True)


Batch = list[PartOfBatch]


def _numbers(unit: str, *names: str) -> tuple[Column, ...]:
    return tuple(Column(name, "number", unit) for name in names)


OF_MEAL = Part(
    "shared",
    (
        Column("meal_id", "id"),
        Column("study", "word"),
        Column("participant", "word"),
        Column("captured_at", "instant"),
        Column("time_zone", "word"),
        Column("local_date", "day"),
        *_numbers("s", "upload_delay_seconds"),
    ),
)
OF_DAY = Part("shared", (Column("day_status", "word"), Column("study_day", "integer")))
OF_FOOD = Part("shared", (Column("food_key", "word"), Column("food_name", "word"), Column("food_table", "word")))
STATE = Part(
    "shared",
    (
        Column("status", "word"),
        Column("origin", "word"),
        Column("provisional", "boolean"),
        Column("reviewed", "boolean"),
    ),
)
VOLUME = Part(
    "numbers",
    (*_numbers("ml", "volume_ml", "volume_low_ml", "volume_high_ml"), *_numbers("g/ml", "density_g_per_ml")),
)
DENSITY_SOURCE = Part("shared", (Column("density_source", "word"),))
AMOUNTS = Part(
    "numbers",
    (
        *_numbers("g", "mass_g", "mass_low_g", "mass_high_g", "edible_g"),
        *_numbers("1", "share"),
        *_numbers("g", "left_g", "consumed_g", "consumed_low_g", "consumed_high_g"),
        *_numbers("kcal", "energy_kcal"),
        *_numbers("g", "protein_g", "fat_g", "carbohydrate_g", "fibre_g", "sugar_g", "saturated_fat_g"),
        *_numbers("mg", "sodium_mg", "potassium_mg", "vitamin_c_mg"),
    ),
)
FLAGS = Part("shared", (Column("flags", "words"),))
CHANGE = Part("numbers", (Column("change_seq", "integer"),))
RECORD_ID = Part("id", (Column("id", "id"),))

RECORD_PARTS = (RECORD_ID, OF_MEAL, STATE, OF_FOOD, VOLUME, DENSITY_SOURCE, AMOUNTS, FLAGS, CHANGE, OF_DAY)
RECORD_COLUMNS: tuple[Column, ...] = tuple(column for part in RECORD_PARTS for column in part.columns)
RECORD_NAMES = tuple(column.name for column in RECORD_COLUMNS)
