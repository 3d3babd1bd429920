"""The columns of each exported table, by what its spec asks for."""

from collections.abc import Iterable, Mapping, Sequence

from app.exports.export_spec import ExportSpec, Rows
from app.http.columns.component_columns import (
    HEADLINE_COMPONENTS,
    KNOWN,
    LONG_AMOUNT,
    LONG_SUM,
    OF_COMPONENT,
    ComponentColumn,
    sum_columns,
)
from app.http.columns.day_columns import DAY_COLUMNS, OF_LONG_DAY
from app.http.columns.dictionary import Column
from app.http.columns.meal_columns import (
    MEAL_COLUMNS,
    MEAL_PROVENANCE,
    OF_LONG_MEAL,
    PARTICIPANT_COLUMNS,
    PHOTOGRAPH_COLUMNS,
    PLACE,
)
from app.http.columns.record_columns import OF_LONG_RECORD, PROVENANCE_COLUMNS, RECORD_COLUMNS
from app.http.file_formats import OF_PLACES

KEYS: Mapping[Rows, tuple[str, ...]] = {  # columns that identify a row
    "items": ("id",),
    "meals": ("study", "participant", "meal_id"),
    "days": ("study", "participant", "local_date"),
    "photographs": ("study", "participant", "meal_id", "slot"),
    "participants": ("study", "participant"),
}
WIDE_COLUMNS: Mapping[Rows, tuple[Column, ...]] = {
    "items": RECORD_COLUMNS,
    "meals": MEAL_COLUMNS,
    "days": DAY_COLUMNS,
    "photographs": PHOTOGRAPH_COLUMNS,
    "participants": PARTICIPANT_COLUMNS,
}
PROVENANCE: Mapping[Rows, tuple[Column, ...]] = {
    "items": PROVENANCE_COLUMNS,
    "meals": MEAL_PROVENANCE,
}
LONG_COLUMNS: Mapping[Rows, tuple[tuple[Column, ...], tuple[Column, ...]]] = {
    "items": (OF_LONG_RECORD, LONG_AMOUNT),
    "meals": (OF_LONG_MEAL, LONG_SUM),
    "days": (OF_LONG_DAY, LONG_SUM),
}


def columns_of(spec: ExportSpec, of_foods: Sequence[ComponentColumn]) -> tuple[Column, ...]:
    """The table's columns from left to right.

    of_foods: the components of the foods in use, where the spec asks for all.
    """
    if spec.layout == "long":
        of_row, of_component = LONG_COLUMNS[spec.rows]
        return (*of_row, *OF_COMPONENT, *of_component, KNOWN)
    columns = WIDE_COLUMNS[spec.rows]
    if spec.provenance:
        columns += PROVENANCE.get(spec.rows, ())
    if spec.rows == "meals" and spec.output not in OF_PLACES:  # their geometry is the place
        columns += PLACE
    if spec.components == "headline":
        return columns
    if spec.rows == "items":
        return without_twins((*columns, *(component.column for component in of_foods)))
    return without_twins((*columns, *sum_columns(of_foods)))


def without_twins(columns: Iterable[Column]) -> tuple[Column, ...]:
    """The columns without those that have an earlier one's name but for its case.

    SQL takes fat_g and FAT_g for one name; what a record holds itself has the same figure.
    """
    by_name: dict[str, Column] = {}
    for column in columns:
        by_name.setdefault(column.name.lower(), column)
    return tuple(by_name.values())


def key_of(spec: ExportSpec) -> tuple[str, ...]:
    """Names of the columns that identify a row of the table."""
    key = KEYS[spec.rows]
    return (*key, "component") if spec.layout == "long" else key


def components_of(
    spec: ExportSpec, of_foods: Sequence[ComponentColumn]
) -> Sequence[ComponentColumn]:
    """The components of the long layout."""
    return HEADLINE_COMPONENTS if spec.components == "headline" else of_foods
