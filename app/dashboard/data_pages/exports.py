"""Exports: a table as a file at once or made in the background, its columns, and the list of files.

The form reads an address's or a form's fields, by the API's names, into the API's schema.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal, get_args
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from pydantic import ValidationError
from starlette.datastructures import ImmutableMultiDict
from starlette.responses import Response

from app.core.errors import InvalidInputError, RateLimitedError
from app.dashboard.forms import Fields, sentence
from app.dashboard.meal_pages.flag_words import FLAGS
from app.dashboard.page import CurrentPage, Page
from app.exports import background_exports
from app.exports.data_dictionary import columns_for
from app.exports.data_dictionary_api import get_data_dictionary
from app.exports.export_files import answer_file
from app.exports.export_size import count_export_rows
from app.exports.export_spec import (
    FILTERS,
    WITHOUT_COMPONENTS,
    ExportSpec,
    Rows,
    check_spec,
    formats_of,
    spec_of_json,
)
from app.exports.models import UNDER_WAY, Export
from app.exports.queries import RequestedExport
from app.exports.schemas import ExportIn
from app.exports.table_columns import key_of
from app.http import paging
from app.http.file_formats import FORMATS, Output
from app.http.paging import Cursor
from app.http.ranges import answer_stored_file
from app.http.row_filter import WIRE_NAMES
from app.meals.stored.models import AfterStatus, MealStatus
from app.meals.stored.record_models import RecordStatus
from app.people.access.page_rules import STUDY_PAGES, study_address

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
router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/exports"
EXPORTS_A_PAGE = 25


@dataclass(frozen=True, slots=True)
class Choice:
    """values: as entered, by the API's names.

    spec: None if they are refused; wrong: field -> why.
    """

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
        return frozenset(WIRE_NAMES[name] for name in FILTERS[_rows_of(self.rows)])

    @property
    def statuses(self) -> Sequence[str]:
        """The statuses that the table's rows may have."""
        return STATUSES[self.rows]

    @property
    def formats(self) -> Mapping[Output, str]:
        """The formats in which the table is offered, and how a form names each."""
        offered = {output: FORMATS[output] for output in formats_of(_rows_of(self.rows))}
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
    """Read the fields.

    drop_others: ignore what the table does not have, as when switching to another table.
    """
    values = _values_of(fields)
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
        return Choice({**values, "rows": [_rows_of(values["rows"][0])]}, None, wrong)
    spec = body.as_spec(study)
    try:
        check_spec(spec)
    except InvalidInputError as error:
        return Choice(values, None, {"": error.message})
    return Choice(values, spec, {})


def _values_of(fields: ImmutableMultiDict[str, object]) -> Values:
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
    rows = _rows_of(values["rows"][0])
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


def _rows_of(name: str) -> Rows:
    return next((rows for rows in get_args(Rows) if rows == name), "items")


def _field(loc: Sequence[int | str]) -> str:
    names = [part for part in loc if isinstance(part, str) and part != "filters"]
    wire = {"first_day": "from", "last_day": "to"}
    return wire.get(names[0], names[0]) if names else ""


@dataclass(frozen=True, slots=True)
class ExportRow:
    """An export in the list.

    filters: by the API's names. may_remove: whether the viewer may remove it.
    """

    export: Export
    spec: ExportSpec
    filters: dict[str, object]
    requested_by: str
    is_under_way: bool
    may_remove: bool


@router.get(PATH)
def get_exports_page(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The form filled in from the address, the columns of the file, and the list of files."""
    choice = choice_of(page.request.query_params, study, drop_others=True)
    return _exports(page, study, choice, cursor, status=422 if choice.wrong else 200)


@router.post(PATH)
def post_export(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Request a file, which a worker makes."""
    choice = choice_of(fields, study)
    if choice.spec is None:
        return _exports(page, study, choice, None, status=422)
    try:
        _, is_new = background_exports.request_export(
            page.database, page.caller, study, choice.spec
        )
    except (InvalidInputError, RateLimitedError) as error:
        return _exports(
            page, study, replace(choice, wrong={"": error.message}), None, status=error.status
        )
    notice = (
        "The file is being made: see below."
        if is_new
        else "This file is already being made for you: see below."
    )
    return page.redirect(f"{study_address(study, 'exports')}?{choice.query()}", notice)


@router.get(f"{PATH}/list")
def get_list(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The list of files; the page polls it while one is being made."""
    return page.render("exports_list.html", exports=_list(page, study, cursor), cursor=cursor)


@router.get(f"{PATH}/table")
def get_table(page: CurrentPage, study: str) -> Response:
    """The rows as a file, at once."""
    spec = _spec(page, study)
    return answer_file(page.state, page.study_caller, spec)


@router.get(f"{PATH}/dictionary")
def get_dictionary(
    page: CurrentPage,
    study: str,
    output: Annotated[Literal["csv", "table-schema"], Query(alias="of")] = "csv",
) -> Response:
    """The data dictionary of the file's columns, as a file."""
    spec = _spec(page, study)
    chosen = (spec.rows, spec.layout, spec.components, study, output, spec.provenance)
    return get_data_dictionary(page.state, page.study_caller, *chosen)


@router.get(f"{PATH}/{{export_id}}/file")
def get_file(page: CurrentPage, study: str, export_id: uuid.UUID) -> Response:
    """A file that was made; interrupted downloads can resume."""
    file = background_exports.open_export(page.database, page.caller, study, export_id)
    return answer_stored_file(page.request, page.state.blobs, file)


@router.post(f"{PATH}/{{export_id}}/removal")
def post_removal(page: CurrentPage, study: str, export_id: uuid.UUID) -> Response:
    """Cancel an export, or remove its file."""
    row = background_exports.read_export(page.database, page.caller, study, export_id)
    background_exports.remove_export(page.database, page.caller, study, export_id)
    notice = (
        "The export was cancelled." if row.export.state in UNDER_WAY else "The export was removed."
    )
    return page.redirect(study_address(study, "exports"), notice)


def _spec(page: Page, study: str) -> ExportSpec:
    """Read the table from the address. Raises InvalidInputError."""
    choice = choice_of(page.request.query_params, study)
    if choice.spec is None:
        name, text = next(iter(choice.wrong.items()))
        raise InvalidInputError(f"{name}: {text}" if name else text, code="export_not_offered")
    return choice.spec


def _exports(page: Page, study: str, choice: Choice, cursor: str | None, status: int) -> Response:
    columns, row_count = None, None
    if choice.spec is not None:
        columns = columns_for(page.database, page.study_caller, choice.spec)
        row_count = count_export_rows(page.database, page.require_study().id, choice.spec)
    return page.render(
        "exports.html",
        status=status,
        choice=choice,
        wrong=choice.wrong,
        tables=TABLES,
        options=OPTIONS,
        columns=columns,
        key=key_of(choice.spec) if choice.spec is not None else (),
        row_count=row_count,
        exports=_list(page, study, cursor),
        cursor=cursor,
    )


def _list(page: Page, study: str, cursor: str | None) -> paging.Page[ExportRow]:
    exports = background_exports.list_exports(
        page.database, page.caller, study, cursor=cursor, limit=EXPORTS_A_PAGE
    )
    return paging.Page([_export_row(page, row) for row in exports.rows], exports.cursor)


def _export_row(page: Page, row: RequestedExport) -> ExportRow:
    export = row.export
    filters = export.spec["filters"]
    return ExportRow(
        export,
        spec_of_json(export.spec),
        filters={
            wire: ", ".join(filters[name]) if isinstance(filters[name], list) else filters[name]
            for name, wire in WIRE_NAMES.items()
            if name in filters and name != "study_code"
        },
        requested_by=row.requested_by,
        is_under_way=export.state in UNDER_WAY,
        may_remove=export.staff_id == page.caller.staff_id or page.may("owner"),
    )
