"""What is to be exported: which rows, in which layout and format, with which components, and the filters.

A spec is plain values: it can be kept as JSON and done later, by another process (spec_as_json, spec_of_json).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from datetime import date
from typing import Any, Literal, get_args

from app.core.errors import InvalidInputError
from app.http.day_order import require_order

Rows = Literal["items", "meals", "days", "photographs"]
Layout = Literal["wide", "long"]
Output = Literal["csv", "ndjson", "parquet", "geojson"]
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
class ExportFilters:
    """None, or an empty tuple, leaves a filter out. first_day, last_day: local days, both included.

    statuses: of the item or the meal, by what a row is. flags to after_statuses: as GET /v1/meals has them.
    """

    study_code: str | None = None
    participant_code: str | None = None
    first_day: date | None = None
    last_day: date | None = None
    food_keys: tuple[str, ...] = ()
    statuses: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    origin: str | None = None
    needs: str | None = None
    failure_codes: tuple[str, ...] = ()
    after_statuses: tuple[str, ...] = ()

    @property
    def set_names(self) -> list[str]:
        """Names of the filters that are set."""
        return sorted(each.name for each in fields(self) if getattr(self, each.name))


@dataclass(frozen=True, slots=True)
class ExportSpec:
    """One table. long: a row a component. all: every component of the foods in use, not the ten headline ones alone.

    provenance: columns that tell where the figures come from.
    """

    rows: Rows
    layout: Layout = "wide"
    output: Output = "csv"
    components: Components = "headline"
    filters: ExportFilters = field(default_factory=ExportFilters)
    provenance: bool = True


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
    first_day, last_day = spec.filters.first_day, spec.filters.last_day
    require_order(first_day, last_day)


def spec_as_json(spec: ExportSpec) -> dict[str, Any]:
    """The spec as JSON values, without filters that are not set; the same of the same."""
    told = asdict(spec)
    told["filters"] = {
        name: value.isoformat() if isinstance(value, date) else list(value) if isinstance(value, tuple) else value
        for name, value in told["filters"].items()
        if value
    }
    return told


def spec_of_json(told: Mapping[str, Any]) -> ExportSpec:
    """The spec that was told by spec_as_json. Raises what check_spec raises."""
    filters: dict[str, Any] = {
        name: date.fromisoformat(value) if name in ("first_day", "last_day") else _as_told(value)
        for name, value in told["filters"].items()
    }
    spec = ExportSpec(**{**told, "filters": ExportFilters(**filters)})
    check_spec(spec)
    return spec


def _as_told(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _not_offered(message: str) -> InvalidInputError:
    return InvalidInputError(message, code="export_not_offered")
