"""/v1/enrolments: a device exchanges its one-time code for a token, without authentication; rate limited by address."""

from fastapi import APIRouter, Request

from app.http.problems import problem_responses
from app.http.rate_limit import EnrolmentLimit, caller_address
from app.people.access.deps import State
from app.people.enrol import NewDevice, enrol_device
from app.people.schemas import EnrolmentIn, EnrolmentOut

router = APIRouter(prefix="/v1/enrolments", tags=["enrolments"])


@router.post("", status_code=201, responses=problem_responses(404, 422, 429))
def post_enrolment(body: EnrolmentIn, request: Request, state: State) -> EnrolmentOut:
    """Exchange a code for a device's token. An unknown, used or expired code gets the same 404."""
    state.part(EnrolmentLimit).take(caller_address(request))
    issued = enrol_device(
        state.database, code=body.code, device=NewDevice(body.device_name, body.model, body.app_version)
    )
    return EnrolmentOut.model_validate(issued, from_attributes=True)
