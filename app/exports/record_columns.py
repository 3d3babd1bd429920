"""The columns of exported records, in their order: those of the API's record, its food as key and name.

A batch is a list of columns, each a list with a value a row: text, float, int, bool, a list of texts, None; instants
and days as RFC 3339 text, as JSON has them.
"""

from dataclasses import dataclass
from typing import Any, Literal

Batch = list[list[Any]]
ColumnType = Literal["id", "word", "instant", "day", "number", "integer", "boolean", "words"]


@dataclass(frozen=True, slots=True)
class Column:
    """A column. type: a "word" is any text, of which there are few. unit: None where the values have none."""

    name: str
    type: ColumnType
    unit: str | None = None


def _numbers(unit: str, *names: str) -> tuple[Column, ...]:
    return tuple(Column(name, "number", unit) for name in names)


RECORD_COLUMNS: tuple[Column, ...] = (
    Column("id", "id"),
    Column("meal_id", "id"),
    Column("study", "word"),
    Column("participant", "word"),
    Column("captured_at", "instant"),
    Column("time_zone", "word"),
    Column("local_date", "day"),
    *_numbers("s", "upload_delay_seconds"),
    Column("status", "word"),
    Column("origin", "word"),
    Column("provisional", "boolean"),
    Column("reviewed", "boolean"),
    Column("food_key", "word"),
    Column("food_name", "word"),
    Column("food_table", "word"),
    *_numbers("ml", "volume_ml", "volume_low_ml", "volume_high_ml"),
    *_numbers("g/ml", "density_g_per_ml"),
    Column("density_source", "word"),
    *_numbers("g", "mass_g", "mass_low_g", "mass_high_g", "edible_g"),
    *_numbers("1", "share"),
    *_numbers("g", "left_g", "consumed_g", "consumed_low_g", "consumed_high_g"),
    *_numbers("kcal", "energy_kcal"),
    *_numbers("g", "protein_g", "fat_g", "carbohydrate_g", "fibre_g", "sugar_g", "saturated_fat_g"),
    *_numbers("mg", "sodium_mg", "potassium_mg", "vitamin_c_mg"),
    Column("flags", "words"),
    Column("change_seq", "integer"),
    Column("day_status", "word"),
    Column("study_day", "integer"),
)
RECORD_NAMES = tuple(column.name for column in RECORD_COLUMNS)
