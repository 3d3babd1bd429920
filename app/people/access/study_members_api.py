"""/v1/studies/{study}/members: the study's owners give, change and remove roles of staff."""

from fastapi import APIRouter, Request, Response

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import StaffName, StudyCode
from app.http.problems import problem_responses
from app.people.access import study_members
from app.people.access.deps import CurrentStaff, State
from app.people.access.staff_schemas import MemberIn, MemberList, MemberOut

router = APIRouter(prefix="/v1/studies/{study}/members", tags=["studies"], route_class=ListRoute)


@router.get("", responses=problem_responses(401, 403, 404, 422))
def get_members(
    request: Request,
    study: StudyCode,
    state: State,
    _: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> MemberList:
    """The study's members by name."""
    page = study_members.list_members(state.database, study, cursor=cursor, limit=limit)
    items = [MemberOut.model_validate(row, from_attributes=True) for row in page.rows]
    return MemberList(items=items, next=next_page(request, page.cursor))


@router.put("/{name}", responses=problem_responses(401, 403, 404, 409, 422))
def put_member(
    study: StudyCode, name: StaffName, body: MemberIn, state: State, caller: CurrentStaff
) -> MemberOut:
    """Give a staff member a role in the study or change it. The last owner keeps the role."""
    member = study_members.set_member(state.database, caller, study, name, body.role)
    return MemberOut.model_validate(member, from_attributes=True)


@router.delete("/{name}", status_code=204, responses=problem_responses(401, 403, 404, 409, 422))
def delete_member(
    study: StudyCode, name: StaffName, state: State, caller: CurrentStaff
) -> Response:
    """Remove a member from the study, which their tokens no longer reach. The last owner cannot be removed."""
    study_members.remove_member(state.database, caller, study, name)
    return Response(status_code=204)
