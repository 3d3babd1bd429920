"""/v1/enrolments: a device exchanges its one-time code for a token, without authentication; rate limited by address."""

from typing import Any

from fastapi import APIRouter, Request, Response

from app.http.problems import problem_responses
from app.http.rate_limit import EnrolmentLimit, caller_address
from app.people.access.deps import State
from app.people.access.secret_box import SecretBox
from app.people.enrol import NewDevice, enrol_device
from app.people.schemas import EnrolmentIn, EnrolmentOut

router = APIRouter(prefix="/v1/enrolments", tags=["enrolments"])


ENROL_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {
        "model": EnrolmentOut,
        "description": "The same as before: this phone was enrolled by the same secret.",
    },
    **problem_responses(404, 422, 429),
}


@router.post("", status_code=201, responses=ENROL_RESPONSES)
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
