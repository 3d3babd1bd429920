"""/v1/studies/{study}/remeasurements: kept photographs measured again by today's pipeline, in the background."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import RemeasurementId, StudyCode
from app.http.problems import Responses, problem_responses
from app.people.access.caller import StaffCaller
from app.people.access.deps import CurrentStaff, State
from app.records.remeasurements import remeasurements
from app.records.remeasurements.remeasurements import Requester
from app.records.remeasurements.schemas import (
    LIMIT,
    MEALS,
    MOST_MEALS,
    ComparedItemList,
    RemeasurementIn,
    RemeasurementList,
    RemeasurementOut,
    RemeasurementPlanOut,
    Selection,
)

router = APIRouter(
    tags=["remeasurements"], route_class=ListRoute, responses=problem_responses(401, 403, 404, 422)
)

REMEASUREMENTS = "/v1/studies/{study}/remeasurements"
START_RESPONSES: Responses = {
    200: {
        "model": RemeasurementOut,
        "description": "The unfinished one of the same selection, which goes on.",
    },
    202: {"model": RemeasurementOut, "description": "Started; Location names it."},
    **problem_responses(409),
}


@router.get("/v1/studies/{study}/remeasurement-plan")
def get_remeasurement_plan(
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    meal: Annotated[list[uuid.UUID] | None, Query(max_length=MOST_MEALS, description=MEALS)] = None,
    limit: Annotated[int | None, Query(ge=1, le=2**31 - 1, description=LIMIT)] = None,
) -> RemeasurementPlanOut:
    """Return which pairs a remeasurement would measure and which it would skip. Nothing is changed."""
    selection = Selection(frozenset(meal or ()), limit)
    return remeasurements.count_plan(
        remeasurements.plan_remeasurement(state.database, _requester(caller), study, selection)
    )


@router.post(REMEASUREMENTS, status_code=202, responses=START_RESPONSES)
def post_remeasurement(
    study: StudyCode, body: RemeasurementIn, state: State, caller: CurrentStaff, response: Response
) -> RemeasurementOut:
    """Measure kept photographs again while no meal waits for a worker. Poll `Location`; people's events stay on top."""
    view, is_new = remeasurements.start_remeasurement(
        state.database, _requester(caller), study, body.as_selection()
    )
    response.headers["Location"] = f"/v1/studies/{study}/remeasurements/{view.id}"
    response.status_code = 202 if is_new else 200
    return view


@router.get(REMEASUREMENTS)
def get_remeasurements(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> RemeasurementList:
    """The study's remeasurements, the newest first."""
    page = remeasurements.list_remeasurements(
        state.database, _requester(caller), study, cursor=cursor, limit=limit
    )
    return RemeasurementList(items=page.rows, next=next_page(request, page.cursor))


@router.get(f"{REMEASUREMENTS}/{{remeasurement}}")
def get_remeasurement(
    study: StudyCode, remeasurement: RemeasurementId, state: State, caller: CurrentStaff
) -> RemeasurementOut:
    """A remeasurement and its progress."""
    return remeasurements.read_remeasurement(
        state.database, _requester(caller), study, remeasurement
    )


@router.get(f"{REMEASUREMENTS}/{{remeasurement}}/items")
def get_remeasured_items(
    request: Request,
    study: StudyCode,
    remeasurement: RemeasurementId,
    state: State,
    caller: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> ComparedItemList:
    """The table of old and new volumes so far, one row per item; a pair without items has one row too."""
    page = remeasurements.list_compared(
        state.database, _requester(caller), study, remeasurement, cursor=cursor, limit=limit
    )
    return ComparedItemList(items=page.rows, next=next_page(request, page.cursor))


@router.post(f"{REMEASUREMENTS}/{{remeasurement}}/stop", responses=problem_responses(409))
def post_stop(
    study: StudyCode, remeasurement: RemeasurementId, state: State, caller: CurrentStaff
) -> RemeasurementOut:
    """Stop a remeasurement. What was measured stays; pairs in progress are measured when it is continued."""
    return remeasurements.stop_remeasurement(
        state.database, _requester(caller), study, remeasurement
    )


@router.post(f"{REMEASUREMENTS}/{{remeasurement}}/continue", responses=problem_responses(409))
def post_continue(
    study: StudyCode, remeasurement: RemeasurementId, state: State, caller: CurrentStaff
) -> RemeasurementOut:
    """Continue a stopped remeasurement where it was."""
    return remeasurements.continue_remeasurement(
        state.database, _requester(caller), study, remeasurement
    )


def _requester(caller: StaffCaller) -> Requester:
    return Requester(caller.name, caller)
