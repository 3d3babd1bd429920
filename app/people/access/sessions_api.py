"""/v1/sessions: staff sign in with name and password, and out. Rate limited by address and by name."""

from fastapi import APIRouter, Request, Response

from app.http.problems import problem_responses
from app.http.rate_limit import caller_address
from app.people.access import sign_in
from app.people.access.deps import CurrentStaff, State
from app.people.access.passwords import Passwords
from app.people.access.sign_in_limits import SignInLimits
from app.people.access.staff_schemas import (
    EndedAccessOut,
    PasswordChangeIn,
    SessionIn,
    SessionIssued,
    SessionOut,
)

router = APIRouter(prefix="/v1/sessions", tags=["sessions"])


@router.post("", status_code=201, responses=problem_responses(401, 422, 429, 503))
def post_session(body: SessionIn, request: Request, state: State) -> SessionIssued:
    """Sign in. An unknown name, a wrong password and a disabled account get the same 401, after the same time."""
    with state.part(SignInLimits).trying(body.name, caller_address(request)):
        issued = sign_in.sign_in(
            state.database, state.part(Passwords), body.name, body.password.get_secret_value()
        )
    return SessionIssued.model_validate(issued, from_attributes=True)


@router.get("/current", responses=problem_responses(401, 403))
def get_current_session(state: State, caller: CurrentStaff) -> SessionOut:
    """The staff member who is signed in."""
    return SessionOut.model_validate(
        sign_in.read_session(state.database, caller), from_attributes=True
    )


@router.delete("/current", status_code=204, responses=problem_responses(401, 403))
def delete_current_session(state: State, caller: CurrentStaff) -> Response:
    """Sign out: the token ends."""
    sign_in.sign_out(state.database, caller)
    return Response(status_code=204)


@router.post("/current/password", responses=problem_responses(401, 403, 422, 429, 503))
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
