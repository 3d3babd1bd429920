"""The form of an export: what is asked for, by the API's names, from an address or a form's fields."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, get_args
from urllib.parse import urlencode

from pydantic import ValidationError
from starlette.datastructures import ImmutableMultiDict

from app.core.errors import InvalidInputError
from app.dashboard.meal_pages.flag_words import FLAGS
from app.dashboard.refusals import sentence
from app.exports.export_spec import FILTERS, ExportSpec, Rows, check_spec
from app.exports.schemas import ExportIn
from app.http.row_filter import WIRE_NAMES
from app.meals.models import AfterStatus, MealStatus
from app.meals.record_models import RecordStatus

TABLES: Final = (("items", "Items"), ("meals", "Meals"), ("days", "Days"), ("photographs", "Photographs"))
SAID_ONCE: Final = ("participant", "from", "to", "origin", "needs")
USUAL: Final = {"rows": "items", "layout": "wide", "components": "headline", "format": "csv", "provenance": "true"}
TYPED: Final = ("food", "failure")  # several in one field, blanks between
CHOSEN: Final = ("status", "flag", "after_status")  # a field each
ITEM_STATUSES, MEAL_STATUSES = get_args(RecordStatus), get_args(MealStatus)
STATUSES: Mapping[str, Sequence[str]] = {
    "items": ITEM_STATUSES,
    "meals": MEAL_STATUSES,
    "photographs": MEAL_STATUSES,
    "days": (),
}
OPTIONS: Mapping[str, Sequence[str]] = {"flag": tuple(FLAGS), "after_status": get_args(AfterStatus)}
FORMATS: Mapping[str, Sequence[str]] = {
    "items": ("csv", "parquet", "ndjson", "geojson"),
    "meals": ("csv", "parquet", "ndjson", "geojson"),
    "days": ("csv", "parquet", "ndjson"),
    "photographs": ("csv", "parquet", "ndjson"),
}

Told = Mapping[str, Sequence[str]]


@dataclass(frozen=True, slots=True)
class Choice:
    """told: the values that were chosen, by the API's names.

    spec: None where it cannot be; wrong: why, by field.
    """

    told: Told
    spec: ExportSpec | None
    wrong: Mapping[str, str]

    @property
    def rows(self) -> str:
        """Which table."""
        return self.told["rows"][0]

    @property
    def filters(self) -> frozenset[str]:
        """The filters that the table has, by the API's names."""
        return frozenset(WIRE_NAMES[name] for name in FILTERS[_rows(self.rows)])

    @property
    def statuses(self) -> Sequence[str]:
        """Those that its rows may have."""
        return STATUSES[self.rows]

    @property
    def formats(self) -> Sequence[str]:
        """Those that the table is offered in."""
        return FORMATS[self.rows]

    def query(self, **changes: str) -> str:
        """The choice as an address's query; with changes, which may be of another table."""
        told = {**self.told, **{name: [value] for name, value in changes.items()}}
        return urlencode([(name, value) for name, values in told.items() for value in values])


def choice_of(fields: ImmutableMultiDict[str, object], study: str, *, drop_others: bool = False) -> Choice:
    """What fields say. drop_others: what the table does not have is left out, as when another table is looked at."""
    told = _told(fields)
    if drop_others:
        told = _fitting(told)
    wrong = _unknown(told)
    body: ExportIn | None = None
    try:
        body = ExportIn.model_validate(_body(told))
    except ValidationError as error:
        wrong = {_field(one["loc"]): sentence(one["type"], one["msg"]) for one in error.errors()} | wrong
    if body is None or wrong:
        return Choice({**told, "rows": [_rows(told["rows"][0])]}, None, wrong)
    spec = body.as_spec(study)
    try:
        check_spec(spec)
    except InvalidInputError as error:
        return Choice(told, None, {"": error.message})
    return Choice(told, spec, {})


def _told(fields: ImmutableMultiDict[str, object]) -> Told:
    told = {name: [str(fields.get(name) or usual).strip()] for name, usual in USUAL.items()}
    told |= {name: [text for text in [str(fields.get(name) or "").strip()] if text] for name in SAID_ONCE}
    told |= {name: " ".join(map(str, fields.getlist(name))).replace(",", " ").split() for name in TYPED}
    return told | {name: [str(value) for value in fields.getlist(name) if value] for name in CHOSEN}


def _fitting(told: Told) -> Told:
    """Without filters, statuses and formats that the table does not have."""
    rows = _rows(told["rows"][0])
    offered = {*USUAL, *(WIRE_NAMES[name] for name in FILTERS[rows])}
    kept = {name: values if name in offered else [] for name, values in told.items()}
    kept |= {"rows": [rows], "status": [status for status in kept["status"] if status in STATUSES[rows]]}
    if told["format"][0] not in FORMATS[rows]:
        kept["format"] = ["csv"]
    if rows == "photographs":
        kept |= {"layout": ["wide"], "components": ["headline"]}
    return kept


def _unknown(told: Told) -> dict[str, str]:
    """Words that no row has would leave an empty file: they are refused."""
    rows = told["rows"][0]
    options = {**OPTIONS, "status": STATUSES.get(rows, ())}
    return {
        name: f"There is no {value!r}."
        for name in CHOSEN
        for value in told[name]
        if value not in options[name] and rows != "days"
    }


def _body(told: Told) -> dict[str, object]:
    filters = {
        name: values[0] if name in SAID_ONCE else values
        for name, values in told.items()
        if values and name not in USUAL
    }
    return {name: told[name][0] for name in USUAL} | {"filters": filters}


def _rows(told: str) -> Rows:
    return next((rows for rows in get_args(Rows) if rows == told), "items")


def _field(place: Sequence[int | str]) -> str:
    named = [str(part) for part in place if isinstance(part, str) and part != "filters"]
    wire = {"first_day": "from", "last_day": "to"}
    return wire.get(named[0], named[0]) if named else ""
