"""Remeasurements: kept photographs measured again, with progress, and old and new volumes side by side."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError
from app.dashboard.forms import (
    EMPTY_FORM,
    Blank,
    Fields,
    FormState,
    form_values,
    read_form,
    refused,
)
from app.dashboard.page import CurrentPage, Page
from app.http.flat_list import ListRoute
from app.http.paging import Cursor
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.records.remeasurements import remeasurements
from app.records.remeasurements.api import get_remeasured_items
from app.records.remeasurements.remeasurements import Requester
from app.records.remeasurements.schemas import (
    RemeasurementIn,
    RemeasurementOut,
    RemeasurementPlanOut,
    Selection,
)

router = APIRouter(include_in_schema=False, route_class=ListRoute)

PATH = f"{STUDY_PAGES}/remeasurements"
A_PAGE = 50
ROWS_A_PAGE = 100

MealLimit = Annotated[int | None, Query(ge=1, le=2**31 - 1), Blank]


@router.get(PATH)
def get_remeasurements_page(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The study's remeasurements, the newest first, and the form for owners to start one."""
    return _remeasurements(page, study, cursor)


@router.get(f"{STUDY_PAGES}/remeasurement-plan")
def get_plan(page: CurrentPage, study: str, limit: MealLimit = None) -> Response:
    """The same page with the numbers of pairs that would be measured and skipped now."""
    pairs = remeasurements.plan_remeasurement(
        page.database, _requester(page), study, Selection(frozenset(), limit)
    )
    values = {"limit": "" if limit is None else str(limit)}
    return _remeasurements(
        page, study, form=FormState(values), plan=remeasurements.count_plan(pairs)
    )


@router.post(PATH)
def post_remeasurement(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Start a remeasurement, or continue the unfinished one of the same selection."""
    values = form_values(fields)
    try:
        body = read_form(RemeasurementIn, values)
        view, is_new = remeasurements.start_remeasurement(
            page.database, _requester(page), study, body.as_selection()
        )
    except (ConflictError, InvalidInputError) as error:
        return _remeasurements(page, study, form=refused(error, values))
    notice = (
        "The remeasurement was started."
        if is_new
        else "The unfinished remeasurement of the same meals goes on."
    )
    return page.redirect(_address(study, view), notice)


@router.get(f"{PATH}/{{remeasurement}}")
def get_remeasurement(
    page: CurrentPage, study: str, remeasurement: uuid.UUID, cursor: Cursor = None
) -> Response:
    """A remeasurement: its progress, and the table of old and new volumes."""
    database, requester = page.database, _requester(page)
    view = remeasurements.read_remeasurement(database, requester, study, remeasurement)
    rows = remeasurements.list_compared(
        database, requester, study, remeasurement, cursor=cursor, limit=ROWS_A_PAGE
    )
    return page.render(
        "remeasurement.html",
        run=view,
        rows=rows.rows,
        next=rows.cursor,
    )


@router.get(f"{PATH}/{{remeasurement}}/state")
def get_state(page: CurrentPage, study: str, remeasurement: uuid.UUID) -> Response:
    """The progress, which the page polls; once it is not running any more the whole page is loaded."""
    view = remeasurements.read_remeasurement(page.database, _requester(page), study, remeasurement)
    if page.is_fragment and view.state != "running":
        return page.redirect(_address(study, view))
    return page.render("remeasurement_state.html", run=view)


@router.post(f"{PATH}/{{remeasurement}}/stop")
def post_stop(page: CurrentPage, study: str, remeasurement: uuid.UUID) -> Response:
    """Stop it."""
    view = remeasurements.stop_remeasurement(page.database, _requester(page), study, remeasurement)
    return page.redirect(
        _address(study, view), "The remeasurement was stopped. What was measured stays."
    )


@router.post(f"{PATH}/{{remeasurement}}/continue")
def post_continue(page: CurrentPage, study: str, remeasurement: uuid.UUID) -> Response:
    """Continue it where it was."""
    view = remeasurements.continue_remeasurement(
        page.database, _requester(page), study, remeasurement
    )
    return page.redirect(_address(study, view), "The remeasurement goes on.")


# the table as a file
router.add_api_route(f"{PATH}/{{remeasurement}}/items", get_remeasured_items, methods=["GET"])


def _remeasurements(
    page: Page,
    study: str,
    cursor: str | None = None,
    *,
    form: FormState = EMPTY_FORM,
    plan: RemeasurementPlanOut | None = None,
) -> Response:
    listed = remeasurements.list_remeasurements(
        page.database, _requester(page), study, cursor=cursor, limit=A_PAGE
    )
    return page.render(
        "remeasurements.html",
        form=form,
        runs=listed.rows,
        next=listed.cursor,
        plan=plan,
    )


def _requester(page: Page) -> Requester:
    return Requester(page.caller.name, page.caller)


def _address(study: str, view: RemeasurementOut) -> str:
    return study_address(study, "remeasurements", view.id)
