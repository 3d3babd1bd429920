"""The specification of an export: rows, layout, format, components, filters.

It can be stored as JSON and carried out later by another process (spec_as_json, spec_of_json).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from pydantic import JsonValue, TypeAdapter

from app.core.errors import InvalidInputError
from app.http.file_formats import FORMATS, Output, file_name
from app.http.paging import require_order
from app.http.row_filter import RowFilter

Rows = Literal["items", "meals", "days", "photographs", "participants"]
Layout = Literal["wide", "long"]
Components = Literal["headline", "all"]

DAYS_AND_PEOPLE = ("study_code", "participant_code", "first_day", "last_day")
MEAL_FILTERS = (
    *DAYS_AND_PEOPLE,
    "food_keys",
    "statuses",
    "flags",
    "origin",
    "needs",
    "failure_codes",
    "after_statuses",
)
FILTERS: Mapping[Rows, tuple[str, ...]] = {  # a table's filters: those of its JSON endpoint
    "items": (*DAYS_AND_PEOPLE, "food_keys", "statuses"),
    "meals": MEAL_FILTERS,
    "days": DAYS_AND_PEOPLE,
    "photographs": MEAL_FILTERS,
    "participants": ("study_code", "participant_code"),
}
WITHOUT_COMPONENTS: tuple[Rows, ...] = ("photographs", "participants")
AT_PLACES: tuple[Rows, ...] = ("items", "meals")  # tables of what was eaten at a place


@dataclass(frozen=True, slots=True)
class ExportSpec:
    """One table. long: one row per component. all: every component of the foods in use, not only the headline ones.

    provenance: columns with the sources of the figures.
    """

    rows: Rows
    layout: Layout = "wide"
    output: Output = "csv"
    components: Components = "headline"
    filters: RowFilter = field(default_factory=RowFilter)
    provenance: bool = True

    @property
    def file_name(self) -> str:
        """The file's name: its study, its table and its days, as far as they are chosen."""
        rows, table = self.filters, "records" if self.rows == "items" else self.rows
        return file_name(self.output, rows.study_code, table, rows.first_day, rows.last_day)


SPEC = TypeAdapter(ExportSpec)


def formats_of(rows: Rows, layout: Layout = "wide") -> tuple[Output, ...]:
    """The formats in which a table is offered."""
    has_places = rows in AT_PLACES and layout == "wide"
    return tuple(output for output, form in FORMATS.items() if has_places or not form.is_places)


def check_spec(spec: ExportSpec) -> None:
    """Raise InvalidInputError: `export_not_offered` for options that the table does not have, `days_reversed`."""
    for name, value, offered in (
        ("rows", spec.rows, Rows),
        ("layout", spec.layout, Layout),
        ("format", spec.output, Output),
        ("components", spec.components, Components),
    ):
        if value not in get_args(offered):
            raise _not_offered(f"There is no {name} {value!r}, but {', '.join(get_args(offered))}.")
    if spec.output not in formats_of(spec.rows, spec.layout):
        title = FORMATS[spec.output].title
        raise _not_offered(f"{title} has one feature per item or meal, in the wide layout only.")
    if spec.rows in WITHOUT_COMPONENTS and (spec.layout == "long" or spec.components == "all"):
        raise _not_offered(f"{spec.rows.capitalize()} have no components: use the wide layout.")
    others = [name for name in spec.filters.set_names if name not in FILTERS[spec.rows]]
    if others:
        raise _not_offered(f"No filter of {spec.rows}: {', '.join(others)}.")
    require_order(spec.filters.first_day, spec.filters.last_day)


def spec_as_json(spec: ExportSpec) -> dict[str, JsonValue]:
    """Return the spec as JSON values, without unset filters; equal specs give equal values."""
    options: dict[str, JsonValue] = SPEC.dump_python(spec, mode="json", exclude={"filters"})
    filters: dict[str, JsonValue] = SPEC.dump_python(
        spec, mode="json", include={"filters": set(spec.filters.set_names)}
    )
    return options | filters


def spec_of_json(stored: Mapping[str, JsonValue]) -> ExportSpec:
    """Return the spec that spec_as_json stored."""
    return SPEC.validate_python(stored)


def _not_offered(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="export_not_offered")
