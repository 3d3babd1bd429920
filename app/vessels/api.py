"""/v1/studies/{study}/vessels, /v1/me/vessels: the mugs and bowls of a study, measured once."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from app.foods.edits.edit_food import author_of
from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit
from app.http.parameters import IfMatch, StudyCode, VesselId, expected_versions
from app.http.problems import problem_responses
from app.people.access.caller import StaffCaller
from app.people.access.deps import CurrentDevice, CurrentStaff, State
from app.vessels import study_vessels
from app.vessels.schemas import (
    PhoneVesselList,
    PhoneVesselOut,
    VesselChangeIn,
    VesselIn,
    VesselList,
    VesselOut,
)
from app.vessels.study_vessels import VesselAuthor, VesselView, stored_measures
from app.vessels.vessel_measures import measured_vessel

router = APIRouter(tags=["vessels"], route_class=ListRoute, responses=problem_responses(401, 403))

VESSELS = "/v1/studies/{study}/vessels"


@router.get(VESSELS, responses=problem_responses(404, 422))
def get_study_vessels(
    request: Request,
    study: StudyCode,
    state: State,
    _: CurrentStaff,
    is_in_use: Annotated[bool | None, Query(description="Default: retired ones too.")] = None,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> VesselList:
    """The study's vessels by name."""
    page = study_vessels.list_vessels(
        state.database, study, is_in_use=is_in_use, cursor=cursor, limit=limit
    )
    return VesselList.of(request, page, render_vessel)


@router.post(VESSELS, status_code=201, responses=problem_responses(404, 409, 413, 422))
def post_study_vessel(
    study: StudyCode, body: VesselIn, state: State, owner: CurrentStaff, response: Response
) -> VesselOut:
    """Keep a vessel. Meals that are estimated from now on are measured with it."""
    view = study_vessels.add_vessel(
        state.database, study, measured_vessel(body.model_dump()), vessel_author(owner)
    )
    response.headers["Location"] = f"/v1/studies/{study}/vessels/{view.vessel.id}"
    return _tagged(view, response)


@router.get(f"{VESSELS}/{{vessel}}", responses=problem_responses(404, 422))
def get_study_vessel(
    study: StudyCode,
    vessel: VesselId,
    state: State,
    _: CurrentStaff,
    response: Response,
    version: Annotated[
        int | None, Query(ge=1, le=2**31 - 1, description="As a run names it; default: now.")
    ] = None,
) -> VesselOut:
    """One vessel, as it is now or as it was in an earlier version. `ETag` names the version, for `If-Match`."""
    return _tagged(study_vessels.read_vessel(state.database, study, vessel, version), response)


@router.put(f"{VESSELS}/{{vessel}}", responses=problem_responses(404, 409, 412, 413, 422, 428))
def put_study_vessel(
    study: StudyCode,
    vessel: VesselId,
    body: VesselChangeIn,
    state: State,
    owner: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
) -> VesselOut:
    """Replace all measures of a vessel, as a new version; a retired one is in use again. Estimates stay as they are."""
    view = study_vessels.change_vessel(
        state.database,
        study,
        vessel,
        body.model_dump(),
        vessel_author(owner),
        expected=expected_versions(if_match),
    )
    return _tagged(view, response)


@router.delete(f"{VESSELS}/{{vessel}}", status_code=204, responses=problem_responses(404, 422))
def delete_study_vessel(
    study: StudyCode, vessel: VesselId, state: State, owner: CurrentStaff
) -> Response:
    """Retire a vessel: estimates get it no more. It stays to be seen, since runs refer to it, and so does its name."""
    study_vessels.retire_vessel(state.database, study, vessel, vessel_author(owner))
    return Response(status_code=204)


@router.get("/v1/me/vessels", responses=problem_responses(410))
def get_own_vessels(state: State, caller: CurrentDevice) -> PhoneVesselList:
    """The vessels that the phone's study uses, by name: offer them, and name the chosen one in a hint's `vessel`."""
    views = study_vessels.vessels_of_phone(state.database, caller)
    return PhoneVesselList(
        items=[
            PhoneVesselOut.model_validate(
                {
                    **stored_measures(view.version),
                    "name": view.vessel.name,
                    "version": view.version.version,
                }
            )
            for view in views
        ]
    )


def render_vessel(view: VesselView) -> VesselOut:
    """A vessel as the API shows it to staff."""
    of_vessel = {name: getattr(view.vessel, name) for name in ("id", "name", "created_at")}
    of_version = {
        name: getattr(view.version, name)
        for name in ("version", "is_retired", "author", "changed_at")
    }
    return VesselOut.model_validate(stored_measures(view.version) | of_vessel | of_version)


def vessel_author(caller: StaffCaller) -> VesselAuthor:
    """Who changes the library through the API or a page."""
    return VesselAuthor(author_of(caller), caller)


def _tagged(view: VesselView, response: Response) -> VesselOut:
    response.headers["ETag"] = f'"{view.version.version}"'
    return render_vessel(view)
