"""/v1/studies/{study}/devices: the participants' phones: when each was last used, and revoking one."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import OfParticipant, StudyCode
from app.http.problems import problem_responses
from app.people import devices
from app.people.access.deps import CurrentStaff, State
from app.people.schemas import DeviceList, DeviceOut, PhoneOut

router = APIRouter(prefix="/v1/studies/{study}/devices", tags=["devices"], route_class=ListRoute)


@router.get("", responses=problem_responses(401, 403, 404, 422))
def get_devices(
    request: Request,
    study: StudyCode,
    state: State,
    _: CurrentStaff,
    participant: OfParticipant = None,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> DeviceList:
    """The study's phones, including revoked ones, the last enrolled first."""
    page = devices.list_devices(state.database, study, participant, cursor=cursor, limit=limit)
    items = [
        DeviceOut(
            **PhoneOut.model_validate(device, from_attributes=True).model_dump(), participant=code
        )
        for device, code in page.rows
    ]
    return DeviceList(items=items, next=next_page(request, page.cursor))


@router.delete("/{device_id}", status_code=204, responses=problem_responses(401, 403, 404, 422))
def delete_study_device(
    study: StudyCode,
    device_id: Annotated[uuid.UUID, Path(description="The phone's id.")],
    state: State,
    caller: CurrentStaff,
) -> Response:
    """End a phone's token, such as that of a lost phone. Its meals stay."""
    devices.revoke_device(state.database, caller, study, device_id)
    return Response(status_code=204)
