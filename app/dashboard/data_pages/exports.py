"""Exports: a table as a file at once or made in the background, its columns, and the list of files."""

import uuid
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError, RateLimitedError
from app.dashboard.addresses import study_address
from app.dashboard.data_pages.export_form import OPTIONS, TABLES, Choice, choice_of
from app.dashboard.forms import Fields
from app.dashboard.page import CurrentPage, Page
from app.exports import background_exports
from app.exports.data_dictionary import columns_for
from app.exports.data_dictionary_api import get_data_dictionary
from app.exports.export_files import answer_file
from app.exports.export_size import count_export_rows
from app.exports.export_spec import ExportSpec, spec_of_json
from app.exports.models import UNDER_WAY, Export
from app.exports.queries import RequestedExport
from app.exports.table_columns import key_of
from app.http import paging
from app.http.paging import Cursor
from app.http.ranges import answer_stored_file
from app.http.row_filter import WIRE_NAMES
from app.people.access.page_rules import STUDY_PAGES

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/exports"
EXPORTS_A_PAGE = 25


@dataclass(frozen=True, slots=True)
class ExportRow:
    """An export in the list. filters: by the API's names. may_remove: whether the viewer may remove it."""

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
            page.state.database, page.caller, study, choice.spec
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
    file = background_exports.open_export(page.state.database, page.caller, study, export_id)
    return answer_stored_file(page.request, page.state.blobs, file)


@router.post(f"{PATH}/{{export_id}}/removal")
def post_removal(page: CurrentPage, study: str, export_id: uuid.UUID) -> Response:
    """Cancel an export, or remove its file."""
    row = background_exports.read_export(page.state.database, page.caller, study, export_id)
    background_exports.remove_export(page.state.database, page.caller, study, export_id)
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
        columns = columns_for(page.state.database, page.study_caller, choice.spec)
        row_count = count_export_rows(page.state.database, page.require_study().id, choice.spec)
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
        page.state.database, page.caller, study, cursor=cursor, limit=EXPORTS_A_PAGE
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
