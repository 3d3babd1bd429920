"""/v1/studies: an admin makes studies, participants and the codes that enrol their phones."""

from typing import Annotated

from fastapi import APIRouter, Path, Response

from app.api.deps import CurrentStaff, State
from app.api.problems import problem_responses
from app.api.schemas.people import EnrolmentCodeOut, ParticipantIn, StudyIn, StudyList, StudyOut
from app.db.models import Study
from app.services import enrol
from app.vision.marker import parse_marker

router = APIRouter(prefix="/v1/studies", tags=["studies"])

StudyCode = Annotated[str, Path(max_length=64)]
RESPONSES = problem_responses(401, 403, 404, 409, 422)


@router.get("", responses=problem_responses(401, 403))
def get_studies(state: State, caller: CurrentStaff) -> StudyList:
    """The studies where the caller has a role."""
    return StudyList(items=[_study_out(study) for study in enrol.list_studies(state.database, caller)])


@router.post("", status_code=201, responses=RESPONSES)
def post_study(body: StudyIn, state: State, _: CurrentStaff) -> StudyOut:
    """Make a study."""
    if body.marker is not None:
        parse_marker(body.marker)
    study = enrol.create_study(
        state.database, code=body.code, name=body.name, marker=body.marker, location_policy=body.location_policy
    )
    return _study_out(study)


@router.post("/{study}/participants", status_code=204, responses=RESPONSES)
def post_participant(study: StudyCode, body: ParticipantIn, state: State, _: CurrentStaff) -> Response:
    """Add a participant."""
    enrol.create_participant(state.database, study_code=study, code=body.code)
    return Response(status_code=204)


@router.post("/{study}/participants/{participant}/enrolment-codes", status_code=201, responses=RESPONSES)
def post_enrolment_code(
    study: StudyCode, participant: Annotated[str, Path(max_length=64)], state: State, _: CurrentStaff
) -> EnrolmentCodeOut:
    """A one-time code for the participant's next device: give it to them as text or as a QR code."""
    issued = enrol.issue_enrolment_code(state.database, study_code=study, participant_code=participant)
    return EnrolmentCodeOut(code=issued.code, expires_at=issued.expires_at)


def _study_out(study: Study) -> StudyOut:
    return StudyOut.model_validate(study, from_attributes=True)
