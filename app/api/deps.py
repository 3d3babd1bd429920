"""What endpoints ask for: the process's state and the caller behind the bearer token."""

from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from app.api.state import ApiState
from app.errors import UnauthenticatedError
from app.services.caller import Caller, DeviceCaller, StaffCaller, authenticate, require_admin, require_device

bearer = HTTPBearer(auto_error=False, description="A device's token (POST /v1/enrolments) or an admin's.")


def api_state(request: Request) -> ApiState:
    """The process's state."""
    state: ApiState = request.app.state.api
    return state


State = Annotated[ApiState, Depends(api_state)]


def current_caller(
    state: State, credentials: Annotated[HTTPAuthorizationCredentials | None, Security(bearer)]
) -> Caller:
    """Who calls. Raises UnauthenticatedError."""
    if credentials is None:
        raise UnauthenticatedError("Send the header `Authorization: Bearer TOKEN`.")
    return authenticate(state.database, credentials.credentials)


CurrentCaller = Annotated[Caller, Depends(current_caller)]


def current_device(caller: CurrentCaller) -> DeviceCaller:
    """The calling phone. Raises NotAllowedError for staff."""
    return require_device(caller)


def current_admin(caller: CurrentCaller) -> StaffCaller:
    """The calling admin. Raises NotAllowedError for all others."""
    return require_admin(caller)


CurrentDevice = Annotated[DeviceCaller, Depends(current_device)]
CurrentAdmin = Annotated[StaffCaller, Depends(current_admin)]
