"""Releases: a study's data frozen under a name, with files, checksums and sources."""

from datetime import datetime

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError
from app.dashboard.data_pages.exports import ITEM_STATUSES
from app.dashboard.forms import EMPTY_FORM, Fields, FormState, form_values, read_form, refused
from app.dashboard.page import CurrentPage, Page
from app.exports.releases import releases
from app.exports.releases.manifest import read_contents
from app.exports.releases.queries import ReleaseRow
from app.exports.releases.releases import CheckedRelease
from app.exports.releases.schemas import ReleaseIn
from app.http import paging
from app.http.paging import Cursor
from app.http.ranges import answer_stored_file
from app.people.access.page_rules import STUDY_PAGES, study_address

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/releases"
RELEASES_A_PAGE = 50
MOVING = ("queued", "running", "changing")


@router.get(PATH)
def get_releases_page(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The releases, the newest first, and the form for owners to make one."""
    return _releases(page, study, cursor)


@router.post(PATH)
def post_release(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Request a release of the current data, which a worker makes."""
    values = {**form_values(fields), "statuses": fields.getlist("statuses")}
    try:
        body = read_form(ReleaseIn, values)
        releases.request_release(
            page.database,
            page.caller,
            study,
            name=body.name,
            note=body.note,
            filters=body.as_filters(),
        )
    except (ConflictError, InvalidInputError) as error:
        name = "name" if isinstance(error, ConflictError) else ""
        return _releases(page, study, form=refused(error, values, name))
    return page.redirect(
        study_address(study, "releases", body.name),
        "The study is being frozen; this page follows it.",
    )


@router.get(f"{STUDY_PAGES}/releases-list")
def get_list(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The list of releases; the page polls it while one is being made."""
    return page.render("releases_list.html", releases=_list(page, study, cursor), cursor=cursor)


@router.get(f"{PATH}/{{name}}")
def get_release(page: CurrentPage, study: str, name: str) -> Response:
    """A release."""
    return _release(page, releases.read_release(page.database, page.caller, study, name))


@router.get(f"{PATH}/{{name}}/state")
def get_state(page: CurrentPage, study: str, name: str) -> Response:
    """The release's state, which the page polls; once it is final the whole page is loaded."""
    release = releases.read_release(page.database, page.caller, study, name).release
    is_moving = release.state in MOVING
    if page.is_fragment and not is_moving:
        return page.redirect(study_address(study, "releases", name))
    return page.render("release_state.html", release=release, is_moving=is_moving)


@router.get(f"{PATH}/{{name}}/check")
def get_check(page: CurrentPage, study: str, name: str) -> Response:
    """The release's page with the result of reading all files back and comparing them with what was frozen."""
    row = releases.read_release(page.database, page.caller, study, name)
    check = releases.check_release(page.database, page.state.blobs, page.caller, study, name)
    return _release(page, row, check)


@router.get(f"{PATH}/{{name}}/files/{{file}}")
def get_file(page: CurrentPage, study: str, name: str, file: str) -> Response:
    """A file of a release."""
    stored_file = releases.open_release_file(page.database, page.caller, study, name, file)
    return answer_stored_file(page.request, page.state.blobs, stored_file)


def _release(page: Page, row: ReleaseRow, check: CheckedRelease | None = None) -> Response:
    release = row.release
    return page.render(
        "release.html",
        release=release,
        requested_by=row.requested_by,
        files=row.files if release.state == "ready" else [],
        former=[
            (checksum, datetime.fromisoformat(until))
            for checksum, until in release.former_checksums
        ],
        contents=read_contents(page.state.blobs, row),
        is_moving=release.state in MOVING,
        check=check,
        file_states={file.name: file.state for file in check.files} if check is not None else {},
    )


def _releases(
    page: Page, study: str, cursor: str | None = None, form: FormState = EMPTY_FORM
) -> Response:
    return page.render(
        "releases.html",
        form=form,
        statuses=ITEM_STATUSES,
        releases=_list(page, study, cursor),
        cursor=cursor,
    )


def _list(page: Page, study: str, cursor: str | None) -> paging.Page[ReleaseRow]:
    return releases.list_releases(
        page.database, page.caller, study, cursor=cursor, limit=RELEASES_A_PAGE
    )
