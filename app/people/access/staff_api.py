"""Staff: /v1/staff and their roles in a study, /v1/sessions to sign in, /v1/tokens for scripts.

Signing in is rate limited by address and by name. Tokens cannot create tokens.
"""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from pydantic import SecretStr

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import StaffName, StudyCode
from app.http.problems import problem_responses
from app.http.rate_limit import caller_address
from app.people.access import access_tokens, sign_in, staff
from app.people.access.deps import CurrentStaff, State
from app.people.access.passwords import Passwords
from app.people.access.secret_box import SecretBox
from app.people.access.sign_in import SignInLimits
from app.people.access.staff_schemas import (
    EndedAccessOut,
    MemberIn,
    MemberList,
    MemberOut,
    PasswordChangeIn,
    SessionIn,
    SessionIssued,
    SessionOut,
    StaffChangedOut,
    StaffIn,
    StaffList,
    StaffOut,
    StaffPatch,
    TokenIn,
    TokenIssued,
    TokenList,
)
from app.people.models import Staff

staff_members = APIRouter(
    prefix="/v1/staff",
    tags=["staff"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 422),
)
sessions = APIRouter(prefix="/v1/sessions", tags=["sessions"])
tokens = APIRouter(
    prefix="/v1/tokens",
    tags=["tokens"],
    route_class=ListRoute,
    responses=problem_responses(401, 403),
)
members = APIRouter(
    prefix="/v1/studies/{study}/members",
    tags=["studies"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)


@staff_members.get("")
def get_staff(
    request: Request, state: State, _: CurrentStaff, limit: Limit = 100, cursor: Cursor = None
) -> StaffList:
    """All staff by name."""
    page = staff.list_staff(state.database, cursor=cursor, limit=limit)
    return StaffList.of(request, page, _render)


@staff_members.post("", status_code=201, responses=problem_responses(409, 503))
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


@staff_members.get("/{name}", responses=problem_responses(404))
def get_staff_member(name: StaffName, state: State, _: CurrentStaff) -> StaffOut:
    """A staff member."""
    return _render(staff.read_staff(state.database, name))


@staff_members.patch("/{name}", responses=problem_responses(404, 409, 503))
def patch_staff(
    name: StaffName, body: StaffPatch, state: State, caller: CurrentStaff
) -> StaffChangedOut:
    """Change a staff member.

    Disabling them, or replacing their password, ends their sessions and personal tokens permanently: see `ended`. A
    first password ends nothing.
    """
    change = staff.StaffChange(
        body.is_admin, body.is_disabled, _secret(body.password), ends_totp=body.ends_totp
    )
    changed = staff.change_staff(state.database, state.part(Passwords), name, change, caller)
    ended = EndedAccessOut.model_validate(changed.ended, from_attributes=True)
    return StaffChangedOut(**_render(changed.staff).model_dump(), ended=ended)


def _secret(password: SecretStr | None) -> str | None:
    return password.get_secret_value() if password is not None else None


def _render(row: Staff) -> StaffOut:
    return StaffOut.model_validate(row, from_attributes=True)


@sessions.post("", status_code=201, responses=problem_responses(401, 422, 429, 503))
def post_session(body: SessionIn, request: Request, state: State) -> SessionIssued:
    """Sign in. An unknown name, a wrong password and a disabled account get the same 401, after the same time."""
    with state.part(SignInLimits).trying(body.name, caller_address(request)):
        return sign_in.sign_in(
            state.database,
            state.part(SecretBox),
            state.part(Passwords),
            body.name,
            body.password.get_secret_value(),
            body.code,
        )


@sessions.get("/current", responses=problem_responses(401, 403))
def get_current_session(state: State, caller: CurrentStaff) -> SessionOut:
    """The staff member who is signed in."""
    return sign_in.read_session(state.database, caller)


@sessions.delete("/current", status_code=204, responses=problem_responses(401, 403))
def delete_current_session(state: State, caller: CurrentStaff) -> Response:
    """Sign out: the token ends."""
    sign_in.sign_out(state.database, caller)
    return Response(status_code=204)


@sessions.post("/current/password", responses=problem_responses(401, 403, 422, 429, 503))
def post_password(
    body: PasswordChangeIn, request: Request, state: State, caller: CurrentStaff
) -> EndedAccessOut:
    """Change your password. All your sessions, this one included, and personal tokens end: sign in again."""
    with state.part(SignInLimits).trying(caller.name, caller_address(request)):
        ended = sign_in.change_own_password(
            state.database,
            state.part(Passwords),
            caller,
            current=body.current_password.get_secret_value(),
            new=body.new_password.get_secret_value(),
        )
    return EndedAccessOut.model_validate(ended, from_attributes=True)


@tokens.get("")
def get_tokens(state: State, caller: CurrentStaff) -> TokenList:
    """The caller's valid tokens, without their secrets."""
    return TokenList(items=access_tokens.list_tokens(state.database, caller))


@tokens.post("", status_code=201, responses=problem_responses(404, 409, 422))
def post_token(body: TokenIn, state: State, caller: CurrentStaff) -> TokenIssued:
    """Create a token; it is shown once. At each call it has its creator's rights, restricted by scope and study."""
    token, view = access_tokens.create_token(
        state.database,
        caller,
        name=body.name,
        scope=body.scope,
        study_code=body.study,
        days=body.days,
    )
    return TokenIssued(token=token, **view.model_dump())


@tokens.delete("/{token_id}", status_code=204, responses=problem_responses(404, 422))
def delete_token(
    token_id: Annotated[uuid.UUID, Path(description="The token's id.")],
    state: State,
    caller: CurrentStaff,
) -> Response:
    """End one of the caller's tokens."""
    access_tokens.revoke_token(state.database, caller, token_id)
    return Response(status_code=204)


@members.get("")
def get_members(
    request: Request,
    study: StudyCode,
    state: State,
    _: CurrentStaff,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> MemberList:
    """The study's members by name."""
    page = staff.list_members(state.database, study, cursor=cursor, limit=limit)
    return MemberList(items=page.rows, next=next_page(request, page.cursor))


@members.put("/{name}", responses=problem_responses(409))
def put_member(
    study: StudyCode, name: StaffName, body: MemberIn, state: State, caller: CurrentStaff
) -> MemberOut:
    """Give a staff member a role in the study or change it. The last owner keeps the role."""
    return staff.set_member(state.database, caller, study, name, body.role)


@members.delete("/{name}", status_code=204, responses=problem_responses(409))
def delete_member(
    study: StudyCode, name: StaffName, state: State, caller: CurrentStaff
) -> Response:
    """Remove a member from the study, which their tokens no longer reach. The last owner cannot be removed."""
    staff.remove_member(state.database, caller, study, name)
    return Response(status_code=204)


router = APIRouter()
for part in (staff_members, sessions, tokens, members):
    router.include_router(part)
