"""What endpoints ask for: the process's state and the caller, whom the route's rule has let in (access_rules.py)."""

from typing import Annotated

from fastapi import Depends

from app.core.errors import UnauthenticatedError
from app.people.access.access_rules import State, authorise
from app.people.access.caller import Caller, DeviceCaller, StaffCaller, require_device, require_staff

__all__ = ["CurrentCaller", "CurrentDevice", "CurrentStaff", "State"]


# async, since they wait for nothing: what is not goes to a thread and back, for each call
async def current_caller(caller: Annotated[Caller | None, Depends(authorise)]) -> Caller:
    """Who calls. Raises UnauthenticatedError."""
    if caller is None:
        raise UnauthenticatedError("Send the header `Authorization: Bearer TOKEN`.")
    return caller


CurrentCaller = Annotated[Caller, Depends(current_caller)]


async def current_device(caller: CurrentCaller) -> DeviceCaller:
    """The calling phone. Raises NotAllowedError for staff."""
    return require_device(caller)


async def current_staff(caller: CurrentCaller) -> StaffCaller:
    """The calling staff member. Raises NotAllowedError for a phone."""
    return require_staff(caller)


CurrentDevice = Annotated[DeviceCaller, Depends(current_device)]
CurrentStaff = Annotated[StaffCaller, Depends(current_staff)]
