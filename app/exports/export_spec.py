"""What is to be exported: which rows, in which layout and format, with which components, and the filters.

A spec is plain values: it can be kept as JSON and done later, by another process (spec_as_json, spec_of_json).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from pydantic import JsonValue, TypeAdapter

from app.core.errors import InvalidInputError
from app.http.paging import require_order
from app.http.row_filter import RowFilter
from app.http.tables.media_types import Output

Rows = Literal["items", "meals", "days", "photographs"]
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
FILTERS: Mapping[Rows, tuple[str, ...]] = {  # which filters each table has: those of its JSON endpoint
    "items": (*DAYS_AND_PEOPLE, "food_keys", "statuses"),
    "meals": MEAL_FILTERS,
    "days": DAYS_AND_PEOPLE,
    "photographs": MEAL_FILTERS,
}


@dataclass(frozen=True, slots=True)
class ExportSpec:
    """One table. long: a row a component. all: every component of the foods in use, not the ten headline ones alone.

    provenance: columns that tell where the figures come from.
    """

    rows: Rows
    layout: Layout = "wide"
    output: Output = "csv"
    components: Components = "headline"
    filters: RowFilter = field(default_factory=RowFilter)
    provenance: bool = True


SPEC = TypeAdapter(ExportSpec)


def check_spec(spec: ExportSpec) -> None:
    """Raises InvalidInputError: `export_not_offered` for what no table has, `days_reversed`."""
    for name, value, offered in (
        ("rows", spec.rows, Rows),
        ("layout", spec.layout, Layout),
        ("format", spec.output, Output),
        ("components", spec.components, Components),
    ):
        if value not in get_args(offered):
            raise _not_offered(f"There is no {name} {value!r}, but {', '.join(get_args(offered))}.")
    if spec.output == "geojson" and (spec.rows not in ("items", "meals") or spec.layout == "long"):
        raise _not_offered("GeoJSON has a feature an item or a meal, in the wide layout.")
    if spec.rows == "photographs" and (spec.layout == "long" or spec.components == "all"):
        raise _not_offered("Photographs have no components: take the wide layout.")
    others = [name for name in spec.filters.set_names if name not in FILTERS[spec.rows]]
    if others:
        raise _not_offered(f"No filter of {spec.rows}: {', '.join(others)}.")
    require_order(spec.filters.first_day, spec.filters.last_day)


def spec_as_json(spec: ExportSpec) -> dict[str, JsonValue]:
    """Return the spec as JSON values, without filters that are not set; the same of the same."""
    told: dict[str, JsonValue] = SPEC.dump_python(spec, mode="json", exclude={"filters"})
    filters: dict[str, JsonValue] = SPEC.dump_python(
        spec, mode="json", include={"filters": set(spec.filters.set_names)}
    )
    return told | filters


def spec_of_json(stored: Mapping[str, JsonValue]) -> ExportSpec:
    """Return the spec that spec_as_json gave as JSON."""
    return SPEC.validate_python(stored)


def _not_offered(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="export_not_offered")
