"""The form of an export: reads an address's or a form's fields, by the API's names, into the API's schema."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, get_args
from urllib.parse import urlencode

from pydantic import ValidationError
from starlette.datastructures import ImmutableMultiDict

from app.core.errors import InvalidInputError
from app.dashboard.meal_pages.flag_words import FLAGS
from app.dashboard.refusals import sentence
from app.exports.export_spec import (
    FILTERS,
    WITHOUT_COMPONENTS,
    ExportSpec,
    Rows,
    check_spec,
    formats_of,
)
from app.exports.schemas import ExportIn
from app.http.file_formats import FORMATS, Output
from app.http.row_filter import WIRE_NAMES
from app.meals.stored.models import AfterStatus, MealStatus
from app.meals.stored.record_models import RecordStatus

TABLES: Final = tuple((rows, rows.capitalize()) for rows in get_args(Rows))
SINGLE: Final = ("participant", "from", "to", "origin", "needs")
DEFAULTS: Final = {
    "rows": "items",
    "layout": "wide",
    "components": "headline",
    "format": "csv",
    "provenance": "true",
}
TYPED: Final = ("food", "failure")  # several values in one field, separated by blanks
CHECKED: Final = ("status", "flag", "after_status")  # one checkbox per value
ITEM_STATUSES, MEAL_STATUSES = get_args(RecordStatus), get_args(MealStatus)
STATUSES: Mapping[str, Sequence[str]] = {
    "items": ITEM_STATUSES,
    "meals": MEAL_STATUSES,
    "photographs": MEAL_STATUSES,
    "days": (),
    "participants": (),
}
OPTIONS: Mapping[str, Sequence[str]] = {"flag": tuple(FLAGS), "after_status": get_args(AfterStatus)}

Values = Mapping[str, Sequence[str]]


@dataclass(frozen=True, slots=True)
class Choice:
    """values: as entered, by the API's names. spec: None if they are refused; wrong: field -> why."""

    values: Values
    spec: ExportSpec | None
    wrong: Mapping[str, str]

    @property
    def rows(self) -> str:
        """The table."""
        return self.values["rows"][0]

    @property
    def filters(self) -> frozenset[str]:
        """The table's filters, by the API's names."""
        return frozenset(WIRE_NAMES[name] for name in FILTERS[_rows(self.rows)])

    @property
    def statuses(self) -> Sequence[str]:
        """The statuses that the table's rows may have."""
        return STATUSES[self.rows]

    @property
    def formats(self) -> Mapping[Output, str]:
        """The formats in which the table is offered, and how a form names each."""
        offered = {output: FORMATS[output] for output in formats_of(_rows(self.rows))}
        return {
            output: f"{form.title}: {form.hint}" if form.hint else form.title
            for output, form in offered.items()
        }

    def query(self, **changes: str) -> str:
        """Encode the choice as an address's query, with changes."""
        values = {**self.values, **{name: [value] for name, value in changes.items()}}
        return urlencode([(name, text) for name, texts in values.items() for text in texts])


def choice_of(
    fields: ImmutableMultiDict[str, object], study: str, *, drop_others: bool = False
) -> Choice:
    """Read the fields. drop_others: ignore what the table does not have, as when switching to another table."""
    values = _values(fields)
    if drop_others:
        values = _offered(values)
    wrong = _unknown(values)
    body: ExportIn | None = None
    try:
        body = ExportIn.model_validate(_body(values))
    except ValidationError as error:
        wrong = {
            _field(part["loc"]): sentence(part["type"], part["msg"]) for part in error.errors()
        } | wrong
    if body is None or wrong:
        return Choice({**values, "rows": [_rows(values["rows"][0])]}, None, wrong)
    spec = body.as_spec(study)
    try:
        check_spec(spec)
    except InvalidInputError as error:
        return Choice(values, None, {"": error.message})
    return Choice(values, spec, {})


def _values(fields: ImmutableMultiDict[str, object]) -> Values:
    values = {
        name: [str(fields.get(name) or default).strip()] for name, default in DEFAULTS.items()
    }
    values |= {
        name: [text for text in [str(fields.get(name) or "").strip()] if text] for name in SINGLE
    }
    values |= {
        name: " ".join(map(str, fields.getlist(name))).replace(",", " ").split() for name in TYPED
    }
    return values | {
        name: [str(value) for value in fields.getlist(name) if value] for name in CHECKED
    }


def _offered(values: Values) -> Values:
    """Drop filters, statuses and formats that the table does not have."""
    rows = _rows(values["rows"][0])
    offered = {*DEFAULTS, *(WIRE_NAMES[name] for name in FILTERS[rows])}
    kept = {name: texts if name in offered else [] for name, texts in values.items()}
    kept |= {
        "rows": [rows],
        "status": [status for status in kept["status"] if status in STATUSES[rows]],
    }
    if values["format"][0] not in formats_of(rows):
        kept["format"] = ["csv"]
    if rows in WITHOUT_COMPONENTS:
        kept |= {"layout": ["wide"], "components": ["headline"]}
    return kept


def _unknown(values: Values) -> dict[str, str]:
    """Refuse values that no row can have: the file would be empty."""
    rows = values["rows"][0]
    options = {**OPTIONS, "status": STATUSES.get(rows, ())}
    return {
        name: f"There is no {value!r}."
        for name in CHECKED
        for value in values[name]
        if value not in options[name] and rows not in ("days", "participants")
    }


def _body(values: Values) -> dict[str, object]:
    filters = {
        name: texts[0] if name in SINGLE else texts
        for name, texts in values.items()
        if texts and name not in DEFAULTS
    }
    return {name: values[name][0] for name in DEFAULTS} | {"filters": filters}


def _rows(name: str) -> Rows:
    return next((rows for rows in get_args(Rows) if rows == name), "items")


def _field(loc: Sequence[int | str]) -> str:
    names = [part for part in loc if isinstance(part, str) and part != "filters"]
    wire = {"first_day": "from", "last_day": "to"}
    return wire.get(names[0], names[0]) if names else ""
