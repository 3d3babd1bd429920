"""/v1/me/days, the diary; /v1/days and a study's intakes, what researchers make of it."""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from app.diary import day_summaries, diary
from app.diary.diary import ParticipantRef
from app.diary.queries import DayRow
from app.diary.schemas import (
    DayIn,
    DayList,
    DayOut,
    DaySummaryOut,
    DaySummaryPage,
    IntakeOut,
    IntakePage,
)
from app.exports.export_files import (
    FILES,
    ComponentsIn,
    DayFilterIn,
    Format,
    LayoutIn,
    answer_file,
    file_spec,
    page_or_file,
)
from app.exports.known_filters import require_known
from app.exports.lists.day_values import day_values
from app.http.flat_list import ListRoute
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit, require_order
from app.http.parameters import (
    FirstDay,
    IfMatch,
    LastDay,
    ParticipantCode,
    StudyCode,
    expected_versions,
)
from app.http.problems import problem_responses
from app.http.text_schemas import LocalDay
from app.meals.stored.event_models import DayEventKind
from app.people.access.deps import CurrentCaller, CurrentDevice, CurrentStaff, State

router = APIRouter(
    prefix="/v1", tags=["days"], route_class=ListRoute, responses=problem_responses(401, 403, 422)
)

Day = Annotated[LocalDay, Path(description="A local day, such as 2026-11-21.")]


@router.get("/me/days")
def get_my_days(
    state: State, device: CurrentDevice, first_day: FirstDay = None, last_day: LastDay = None
) -> DayList:
    """The participant's days that have a meal or a diary entry; without a range, the last month; a year at most."""
    days = diary.list_days(state.database, device, first_day=first_day, last_day=last_day)
    return DayList(items=[DayOut.model_validate(day, from_attributes=True) for day in days])


@router.put("/me/days/{day}", responses=problem_responses(409, 410, 412, 428))
def put_my_day(
    day: Day,
    body: DayIn,
    state: State,
    device: CurrentDevice,
    response: Response,
    if_match: IfMatch = None,
) -> DayOut:
    """Close a day, enter that nothing was eaten, or reopen it. `If-Match` names its version, "0" the first time."""
    row = diary.set_day(
        state.database, device, day, day_event_kind(body), expected=expected_versions(if_match)
    )
    return _tagged(row, response)


@router.get("/studies/{study}/participants/{participant}/days", responses=problem_responses(404))
def get_days_of_participant(
    study: StudyCode,
    participant: ParticipantCode,
    state: State,
    staff: CurrentStaff,
    first_day: FirstDay = None,
    last_day: LastDay = None,
) -> DayList:
    """A participant's days, as their phone lists them."""
    participant_ref = ParticipantRef(study, participant)
    days = diary.list_days(
        state.database,
        staff,
        first_day=first_day,
        last_day=last_day,
        participant_ref=participant_ref,
    )
    return DayList(items=[DayOut.model_validate(day, from_attributes=True) for day in days])


@router.put(
    "/studies/{study}/participants/{participant}/days/{day}",
    responses=problem_responses(404, 409, 412, 428),
)
def put_day_of_participant(
    study: StudyCode,
    participant: ParticipantCode,
    day: Day,
    body: DayIn,
    state: State,
    staff: CurrentStaff,
    response: Response,
    if_match: IfMatch = None,
) -> DayOut:
    """Close or reopen a day as a reviewer; this overrides the participant's entries."""
    row = diary.set_day(
        state.database,
        staff,
        day,
        day_event_kind(body),
        expected=expected_versions(if_match),
        participant_ref=ParticipantRef(study, participant),
    )
    return _tagged(row, response)


@router.get(
    "/days",
    response_model=DaySummaryPage,
    responses=page_or_file(FILES, 404, 503),
)
def get_days(
    request: Request,
    state: State,
    caller: CurrentCaller,
    chosen: DayFilterIn,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
    layout: LayoutIn = "wide",
    components: ComponentsIn = "headline",
) -> Response:
    """One row per participant and day, including days without food, as JSON pages or a file of one moment."""
    require_known(state.database, caller, chosen)
    spec = file_spec(request, "days", chosen, output, layout, components)
    if spec is not None:
        return answer_file(state, caller, spec)
    page = day_summaries.list_day_summaries(
        state.database, caller, chosen, cursor=cursor, limit=limit
    )
    return ModelResponse(
        DaySummaryPage.of(request, page, lambda day: DaySummaryOut.model_validate(day_values(day)))
    )


@router.get("/studies/{study}/intakes", responses=problem_responses(404))
def get_intakes(
    request: Request,
    study: StudyCode,
    state: State,
    staff: CurrentStaff,
    first_day: FirstDay = None,
    last_day: LastDay = None,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> IntakePage:
    """Each participant's mean daily intake over closed days; open days are left out and counted."""
    require_order(first_day, last_day)
    page = day_summaries.list_intakes(
        state.database,
        staff,
        study,
        first_day=first_day,
        last_day=last_day,
        cursor=cursor,
        limit=limit,
    )
    return IntakePage.of(
        request, page, lambda row: IntakeOut.model_validate(row, from_attributes=True)
    )


def day_event_kind(body: DayIn) -> DayEventKind:
    """Return the kind of event for a requested day status."""
    if body.status == "open":
        return "reopened"
    return "ate_nothing" if body.ate_nothing else "closed"


def _tagged(day: DayRow, response: Response) -> DayOut:
    response.headers["ETag"] = f'"{day.version}"'
    return DayOut.model_validate(day, from_attributes=True)
