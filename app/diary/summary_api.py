"""/v1/me/summary: a participant's feedback for a day; the same for staff."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.diary.diary import ParticipantRef
from app.diary.feedback import read_feedback
from app.diary.feedback_schemas import SummaryOut
from app.http.parameters import ParticipantCode, StudyCode
from app.http.problems import problem_responses
from app.http.text_schemas import LocalDay
from app.people.access.deps import CurrentDevice, CurrentStaff, State

router = APIRouter(prefix="/v1", tags=["feedback"])

Day = Annotated[
    LocalDay | None,
    Query(
        alias="date", description="A local day; default: the last one with a meal or a diary entry."
    ),
]


@router.get("/me/summary", responses=problem_responses(401, 403, 410, 422))
def get_my_summary(state: State, device: CurrentDevice, day: Day = None) -> SummaryOut:
    """A day's amounts and, from three closed days on, a comparison; only if the study gives feedback."""
    return SummaryOut.model_validate(
        read_feedback(state.database, device, day), from_attributes=True
    )


@router.get(
    "/studies/{study}/participants/{participant}/summary",
    responses=problem_responses(401, 403, 404, 422),
)
def get_summary_of_participant(
    study: StudyCode,
    participant: ParticipantCode,
    state: State,
    staff: CurrentStaff,
    day: Day = None,
) -> SummaryOut:
    """What the participant sees, or would see if the study gave feedback."""
    feedback = read_feedback(state.database, staff, day, ParticipantRef(study, participant))
    return SummaryOut.model_validate(feedback, from_attributes=True)
