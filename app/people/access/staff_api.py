"""/v1/staff: admins create, change and disable staff."""

from fastapi import APIRouter, Request
from pydantic import SecretStr

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import StaffName
from app.http.problems import problem_responses
from app.people.access import staff
from app.people.access.deps import CurrentStaff, State
from app.people.access.passwords import Passwords
from app.people.access.staff_schemas import (
    EndedAccessOut,
    StaffChangedOut,
    StaffIn,
    StaffList,
    StaffOut,
    StaffPatch,
)
from app.people.models import Staff

router = APIRouter(prefix="/v1/staff", tags=["staff"], route_class=ListRoute)


@router.get("", responses=problem_responses(401, 403, 422))
def get_staff(
    request: Request, state: State, _: CurrentStaff, limit: Limit = 100, cursor: Cursor = None
) -> StaffList:
    """All staff by name."""
    page = staff.list_staff(state.database, cursor=cursor, limit=limit)
    return StaffList(
        items=[_render(row) for row in page.rows], next=next_page(request, page.cursor)
    )


@router.post("", status_code=201, responses=problem_responses(401, 403, 409, 422, 503))
def post_staff(body: StaffIn, state: State, caller: CurrentStaff) -> StaffOut:
    """Create a staff member."""
    row = staff.create_staff(
        state.database,
        state.part(Passwords),
        body.name,
        is_admin=body.is_admin,
        password=_secret(body.password),
        caller=caller,
    )
    return _render(row)


@router.get("/{name}", responses=problem_responses(401, 403, 404, 422))
def get_staff_member(name: StaffName, state: State, _: CurrentStaff) -> StaffOut:
    """A staff member."""
    return _render(staff.read_staff(state.database, name))


@router.patch("/{name}", responses=problem_responses(401, 403, 404, 409, 422, 503))
def patch_staff(
    name: StaffName, body: StaffPatch, state: State, caller: CurrentStaff
) -> StaffChangedOut:
    """Change a staff member.

    Disabling them, or replacing their password, ends their sessions and personal tokens permanently: see `ended`. A
    first password ends nothing.
    """
    change = staff.StaffChange(body.is_admin, body.is_disabled, _secret(body.password))
    changed = staff.change_staff(state.database, state.part(Passwords), name, change, caller)
    ended = EndedAccessOut.model_validate(changed.ended, from_attributes=True)
    return StaffChangedOut(**_render(changed.staff).model_dump(), ended=ended)


def _secret(password: SecretStr | None) -> str | None:
    return password.get_secret_value() if password is not None else None


def _render(row: Staff) -> StaffOut:
    return StaffOut.model_validate(row, from_attributes=True)
