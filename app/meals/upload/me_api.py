"""/v1/me: the phone's participant and the parts of the study's protocol that concern it."""

from fastapi import APIRouter, Response

from app.http.problems import problem_responses
from app.people import devices
from app.people.access.deps import CurrentDevice, State
from app.people.schemas import MeOut, PhoneOut, PhoneProtocol
from app.people.studies_api import render_study

router = APIRouter(prefix="/v1/me", tags=["me"])


@router.get("", responses=problem_responses(401, 403, 410))
def get_me(state: State, caller: CurrentDevice) -> MeOut:
    """The phone's participant, study and itself. Ask again now and then: the protocol may change."""
    study, participant, device, joined_at = devices.read_phone(state.database, caller)
    return MeOut(
        participant=participant.code,
        starts_on=participant.starts_on,
        joined_at=joined_at,
        study=PhoneProtocol(
            **render_study(study).model_dump(include=set(PhoneProtocol.model_fields))
        ),
        device=PhoneOut.model_validate(device, from_attributes=True),
    )


@router.delete("/device", status_code=204, responses=problem_responses(401, 403, 410))
def delete_my_device(state: State, caller: CurrentDevice) -> Response:
    """Sign the phone out: its token is no longer valid. What it sent is kept."""
    devices.sign_out_phone(state.database, caller)
    return Response(status_code=204)
