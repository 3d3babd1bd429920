"""Dependencies of endpoints: the process's state and the authorised caller (access_rules.py)."""

from typing import Annotated

from fastapi import Depends

from app.http.state import ApiState
from app.people.access.access_rules import api_state, current_caller, current_device, current_staff
from app.people.access.caller import Caller, DeviceCaller, StaffCaller

State = Annotated[ApiState, Depends(api_state)]
CurrentCaller = Annotated[Caller, Depends(current_caller)]
CurrentDevice = Annotated[DeviceCaller, Depends(current_device)]
CurrentStaff = Annotated[StaffCaller, Depends(current_staff)]
