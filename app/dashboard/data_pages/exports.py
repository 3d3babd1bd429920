"""Exports: a table as a file at once, or made in the background; its columns; the files that were made."""

import uuid
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError, RateLimitedError
from app.dashboard.addresses import study_address
from app.dashboard.data_pages.export_form import OPTIONS, TABLES, Choice, choice_of
from app.dashboard.forms import Fields
from app.dashboard.one_study import in_study
from app.dashboard.page import CurrentPage, Page
from app.exports import background_exports
from app.exports.data_dictionary import columns_for, key_of
from app.exports.data_dictionary_api import get_data_dictionary
from app.exports.export_files import answer_file
from app.exports.export_size import rows_about
from app.exports.export_spec import ExportSpec, spec_of_json
from app.exports.models import UNDER_WAY
from app.exports.queries import AskedExport
from app.http.paging import Cursor
from app.http.ranges import answer_stored_file
from app.http.row_filter import WIRE_NAMES
from app.people.access.page_rules import STUDY_PAGES

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/exports"
EXPORTS_A_PAGE = 25
FILE_NAMES = {"items": "records", "meals": "meals", "days": "days", "photographs": "photographs"}  # as the API has them


@router.get(PATH)
def get_exports_page(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The form, as the address says; the columns that the file would have; the files that were made."""
    choice = choice_of(page.request.query_params, study, drop_others=True)
    return _exports(page, study, choice, cursor, status=422 if choice.wrong else 200)


@router.post(PATH)
def post_export(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Ask for a file: a worker makes it."""
    choice = choice_of(fields, study)
    if choice.spec is None:
        return _exports(page, study, choice, None, status=422)
    try:
        _, is_new = background_exports.request_export(page.state.database, page.caller, study, choice.spec)
    except (InvalidInputError, RateLimitedError) as error:
        return _exports(page, study, Choice(choice.told, choice.spec, {"": error.message}), None, status=error.status)
    told = "The file is being made: see below." if is_new else "This file is being made for you already: see below."
    return page.go(f"{study_address(study, 'exports')}?{choice.query()}", told)


@router.get(f"{PATH}/list")
def get_list(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The files and how far they are: the page asks for it again and again while one is being made."""
    return page.render("exports_list.html", **_list(page, study, cursor))


@router.get(f"{PATH}/table")
def get_table(page: CurrentPage, study: str) -> Response:
    """The rows as a file, at once."""
    spec = _spec(page, study)
    return answer_file(page.state, in_study(page), spec, FILE_NAMES[spec.rows])


@router.get(f"{PATH}/dictionary")
def get_dictionary(
    page: CurrentPage, study: str, output: Annotated[Literal["csv", "table-schema"], Query(alias="of")] = "csv"
) -> Response:
    """What every column of the file says, as a file."""
    spec = _spec(page, study)
    chosen = (spec.rows, spec.layout, spec.components, study, output, spec.provenance)
    return get_data_dictionary(page.state, in_study(page), *chosen)


@router.get(f"{PATH}/{{export_id}}/file")
def get_file(page: CurrentPage, study: str, export_id: uuid.UUID) -> Response:
    """A file that was made; a download that broke off goes on."""
    file = background_exports.open_export(page.state.database, page.caller, study, export_id)
    return answer_stored_file(page.request, page.state.blobs, file)


@router.post(f"{PATH}/{{export_id}}/removal")
def post_removal(page: CurrentPage, study: str, export_id: uuid.UUID) -> Response:
    """Call an export off, or remove its file."""
    asked = background_exports.read_export(page.state.database, page.caller, study, export_id)
    background_exports.remove_export(page.state.database, page.caller, study, export_id)
    told = "The export was called off." if asked.export.state in UNDER_WAY else "The export was removed."
    return page.go(study_address(study, "exports"), told)


def _spec(page: Page, study: str) -> ExportSpec:
    """What the address asks for. Raises InvalidInputError."""
    choice = choice_of(page.request.query_params, study)
    if choice.spec is None:
        name, sentence = next(iter(choice.wrong.items()))
        raise InvalidInputError(f"{name}: {sentence}" if name else sentence, code="export_not_offered")
    return choice.spec


def _exports(page: Page, study: str, choice: Choice, cursor: str | None, status: int) -> Response:
    columns, about = None, None
    if choice.spec is not None:
        columns = columns_for(page.state.database, in_study(page), choice.spec)
        about = rows_about(page.state.database, page.study.id, choice.spec) if page.study is not None else None
    return page.render(
        "exports.html",
        status=status,
        choice=choice,
        wrong=choice.wrong,
        tables=TABLES,
        options=OPTIONS,
        columns=columns,
        key=key_of(choice.spec) if choice.spec is not None else (),
        about=about,
        **_list(page, study, cursor),
    )


def _list(page: Page, study: str, cursor: str | None) -> dict[str, Any]:
    found = background_exports.list_exports(
        page.state.database, page.caller, study, cursor=cursor, limit=EXPORTS_A_PAGE
    )
    return {
        "exports": [_shown(page, asked) for asked in found.rows],
        "is_moving": any(asked.export.state in UNDER_WAY for asked in found.rows),
        "next": found.cursor,
        "cursor": cursor,
    }


def _shown(page: Page, asked: AskedExport) -> dict[str, Any]:
    """An export, what it is of by the API's names, and whether its viewer may remove it."""
    export = asked.export
    told = export.spec["filters"]
    filters = {
        wire: ", ".join(told[name]) if isinstance(told[name], list) else told[name]
        for name, wire in WIRE_NAMES.items()
        if name in told and name != "study_code"
    }
    return {
        "export": export,
        "spec": spec_of_json(export.spec),
        "filters": filters,
        "asked_by": asked.asked_by,
        "is_under_way": export.state in UNDER_WAY,
        "may_remove": export.staff_id == page.caller.staff_id or page.may("owner"),
    }
