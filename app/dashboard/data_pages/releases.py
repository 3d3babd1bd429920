"""Releases: a study's data frozen under a name; each with its files, checksums, and what it was made of."""

from datetime import datetime
from typing import Any

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError
from app.dashboard.addresses import study_address
from app.dashboard.data_pages.export_form import ITEM_STATUSES
from app.dashboard.forms import Fields, checked, typed
from app.dashboard.page import CurrentPage, Page
from app.http.paging import Cursor
from app.http.ranges import answer_stored_file
from app.people.access.page_rules import STUDY_PAGES
from app.releases import releases
from app.releases.freeze_release import ReleaseFilters
from app.releases.queries import NamedRelease
from app.releases.release_contents import read_contents
from app.releases.releases import CheckedRelease
from app.releases.schemas import ReleaseIn

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/releases"
RELEASES_A_PAGE = 50
MOVING = ("queued", "running", "changing")


@router.get(PATH)
def get_releases_page(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """All of them, the newest first; an owner freezes another."""
    return _releases(page, study, cursor)


@router.post(PATH)
def post_release(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Freeze the data as they are now: a worker does it."""
    values: dict[str, Any] = typed(fields) | {"statuses": [str(one) for one in fields.getlist("statuses")]}
    body, wrong = checked(ReleaseIn, values)
    if body is None:
        return _releases(page, study, None, values=values, wrong=wrong, status=422)
    filters = ReleaseFilters(body.first_day, body.last_day, tuple(sorted(set(body.statuses))))
    try:
        releases.request_release(
            page.state.database, page.caller, study, name=body.name, note=body.note, filters=filters
        )
    except ConflictError as error:
        return _releases(page, study, None, values=values, wrong={"name": error.message}, status=error.status)
    except InvalidInputError as error:
        return _releases(page, study, None, values=values, wrong={"": error.message}, status=error.status)
    return page.go(study_address(study, "releases", body.name), "The study is being frozen; this page follows it.")


@router.get(f"{STUDY_PAGES}/releases-list")
def get_list(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The list again, while one of them is being made."""
    return page.render("releases_list.html", **_list(page, study, cursor))


@router.get(f"{PATH}/{{name}}")
def get_release(page: CurrentPage, study: str, name: str) -> Response:
    """One of them."""
    return _release(page, releases.read_release(page.state.database, page.caller, study, name))


@router.get(f"{PATH}/{{name}}/state")
def get_state(page: CurrentPage, study: str, name: str) -> Response:
    """How it stands: what the page asks again and again. When that is settled the whole page comes."""
    found = releases.read_release(page.state.database, page.caller, study, name)
    if page.is_fragment and found.release.state not in MOVING:
        return page.go(study_address(study, "releases", name))
    return page.render("release_state.html", found=found, release=found.release, is_moving=_is_moving(found))


@router.get(f"{PATH}/{{name}}/check")
def get_check(page: CurrentPage, study: str, name: str) -> Response:
    """Its page, after all files were read back and compared with what was frozen."""
    found = releases.read_release(page.state.database, page.caller, study, name)
    checked_release = releases.check_release(page.state.database, page.state.blobs, page.caller, study, name)
    return _release(page, found, checked_release)


@router.get(f"{PATH}/{{name}}/files/{{file}}")
def get_file(page: CurrentPage, study: str, name: str, file: str) -> Response:
    """A file of it."""
    found = releases.open_release_file(page.state.database, page.caller, study, name, file)
    return answer_stored_file(page.request, page.state.blobs, found)


def _release(page: Page, found: NamedRelease, checked_release: CheckedRelease | None = None) -> Response:
    return page.render(
        "release.html",
        found=found,
        release=found.release,
        files=found.files if found.release.state == "ready" else [],
        former=[(checksum, datetime.fromisoformat(until)) for checksum, until in found.release.former_checksums],
        contents=read_contents(page.state.blobs, found),
        is_moving=_is_moving(found),
        check=checked_release,
        state_of={file.name: file.found for file in checked_release.files} if checked_release is not None else {},
    )


def _releases(
    page: Page,
    study: str,
    cursor: str | None,
    *,
    values: dict[str, Any] | None = None,
    wrong: dict[str, str] | None = None,
    status: int = 200,
) -> Response:
    return page.render(
        "releases.html",
        status=status,
        values=values or {},
        wrong=wrong or {},
        statuses=ITEM_STATUSES,
        **_list(page, study, cursor),
    )


def _list(page: Page, study: str, cursor: str | None) -> dict[str, Any]:
    found = releases.list_releases(page.state.database, page.caller, study, cursor=cursor, limit=RELEASES_A_PAGE)
    return {
        "rows": found.rows,
        "is_moving": any(_is_moving(one) for one in found.rows),
        "next": found.cursor,
        "cursor": cursor,
    }


def _is_moving(found: NamedRelease) -> bool:
    return found.release.state in MOVING
