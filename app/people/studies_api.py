"""/v1/studies: admins create studies, owners change the protocol."""

from typing import cast

from fastapi import APIRouter, Request, Response

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit
from app.http.parameters import IfMatch, StudyCode, expected_versions
from app.http.problems import problem_responses
from app.people import studies
from app.people.access.deps import CurrentStaff, State
from app.people.location_policy import FilesWithPlaces
from app.people.models import Study
from app.people.schemas import ProtocolIn, StudyIn, StudyList, StudyOut, StudyPatch
from app.people.studies import ProtocolChange

router = APIRouter(
    prefix="/v1/studies",
    tags=["studies"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 422),
)


@router.get("")
def get_studies(
    request: Request, state: State, caller: CurrentStaff, limit: Limit = 100, cursor: Cursor = None
) -> StudyList:
    """The studies in which the caller has a role."""
    page = studies.list_studies(state.database, caller, cursor=cursor, limit=limit)
    return StudyList.of(request, page, render_study)


@router.post("", status_code=201, responses=problem_responses(409))
def post_study(body: StudyIn, state: State, caller: CurrentStaff, response: Response) -> StudyOut:
    """Create a study."""
    study = studies.create_study(
        state.database,
        code=body.code,
        name=body.name,
        caller=caller,
        protocol=protocol_columns(body),
        is_sandbox=body.sandbox,
    )
    response.headers["Location"] = f"/v1/studies/{body.code}"
    return _tagged(study, response)


@router.get("/{study}", responses=problem_responses(404))
def get_study(study: StudyCode, state: State, _: CurrentStaff, response: Response) -> StudyOut:
    """A study and its protocol. Send the ETag in `If-Match` to change it."""
    return _tagged(studies.read_study(state.database, study), response)


@router.patch("/{study}", responses=problem_responses(404, 409, 412, 428))
def patch_study(
    study: StudyCode,
    body: StudyPatch,
    state: State,
    caller: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
) -> StudyOut:
    """Change the named fields of the protocol. The day's start is fixed once the study has a meal."""
    changes = protocol_columns(body)
    if "name" in body.model_fields_set:
        changes["name"] = body.name
    expected = expected_versions(if_match)
    return _tagged(
        studies.change_study(
            state.database,
            caller,
            study,
            changes,
            expected=expected,
            files_with_places=state.part(FilesWithPlaces),
        ),
        response,
    )


def render_study(study: Study) -> StudyOut:
    """Return a study as the API shows it."""
    return StudyOut.model_validate(
        {
            name: getattr(study, name)
            for name in StudyOut.model_fields
            if name not in {"day_starts", "sandbox"}
        }
        | {
            "day_starts": clock(study.day_starts_minutes),
            "web_origins": study.web_origins or [],
            "reminder_times": study.reminder_times or [],
            "sandbox": study.is_sandbox,
        }
    )


def minutes_of(clock_time: str) -> int:
    """Return the minutes after midnight of HH:MM."""
    hours, minutes = clock_time.split(":")
    return 60 * int(hours) + int(minutes)


def clock(minutes: int) -> str:
    """Format minutes after midnight as HH:MM."""
    return f"{minutes // 60:02}:{minutes % 60:02}"


def protocol_columns(body: ProtocolIn) -> ProtocolChange:
    """Return the protocol's fields that a body names, as columns of Study."""
    columns = body.model_dump(
        include=body.model_fields_set & ProtocolIn.model_fields.keys(), mode="json"
    )
    if "day_starts" in columns:
        columns["day_starts_minutes"] = minutes_of(columns.pop("day_starts"))
    return cast("ProtocolChange", columns)


def _tagged(study: Study, response: Response) -> StudyOut:
    response.headers["ETag"] = f'"{study.version}"'
    return render_study(study)
