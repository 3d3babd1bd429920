"""Phones: /v1/enrolments exchanges a code for a token, /v1/studies/{study}/devices lists phones.

An enrolment needs no authentication; it is rate limited by address.
"""

import uuid
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from app.http.flat_list import ListRoute
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import OfParticipant, StudyCode
from app.http.problems import Responses, problem_responses
from app.http.rate_limit import EnrolmentLimit, caller_address
from app.people import devices
from app.people.access.deps import CurrentStaff, State
from app.people.access.secret_box import SecretBox
from app.people.devices import NewDevice, enrol_device
from app.people.schemas import DeviceList, DeviceOut, EnrolmentIn, EnrolmentOut, PhoneOut

devices_of_study = APIRouter(
    prefix="/v1/studies/{study}/devices",
    tags=["devices"],
    route_class=ListRoute,
    responses=problem_responses(401, 403, 404, 422),
)
enrolments = APIRouter(prefix="/v1/enrolments", tags=["enrolments"])


ENROL_RESPONSES: Responses = {
    200: {
        "model": EnrolmentOut,
        "description": "The same as before: this phone was enrolled by the same secret.",
    },
    **problem_responses(404, 422, 429),
}


@devices_of_study.get("")
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


@devices_of_study.delete("/{device_id}", status_code=204)
def delete_study_device(
    study: StudyCode,
    device_id: Annotated[uuid.UUID, Path(description="The phone's id.")],
    state: State,
    caller: CurrentStaff,
) -> Response:
    """End a phone's token, such as that of a lost phone. Its meals stay."""
    devices.revoke_device(state.database, caller, study, device_id)
    return Response(status_code=204)


@enrolments.post("", status_code=201, responses=ENROL_RESPONSES)
def post_enrolment(
    body: EnrolmentIn, request: Request, response: Response, state: State
) -> EnrolmentOut:
    """Exchange a code for a device's token. An unknown, used or expired code gets the same 404.

    With a `secret` the call may be repeated: if the answer was lost, the same call gets the same token.
    """
    state.part(EnrolmentLimit).take(caller_address(request))
    issued = enrol_device(
        state.database,
        state.part(SecretBox),
        code=body.code,
        device=NewDevice(body.device_name, body.model, body.app_version),
        secret=body.secret.get_secret_value() if body.secret else None,
    )
    response.status_code = 201 if issued.is_new else 200
    return EnrolmentOut.model_validate(issued, from_attributes=True)


router = APIRouter()
router.include_router(enrolments)
router.include_router(devices_of_study)
