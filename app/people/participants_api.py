"""/v1/studies/{study}/participants: add, read and change a participant; the one-time codes that enrol phones."""

from collections.abc import Mapping

from fastapi import APIRouter, Request, Response

from app.http.model_response import ModelResponse
from app.http.parameters import ParticipantCode, StudyCode
from app.http.problems import Responses, problem_responses
from app.people import participants
from app.people.access.deps import CurrentStaff, State
from app.people.access.page_rules import server_address
from app.people.access.secret_box import SecretBox
from app.people.devices import capture_link, enrolment_text, issue_enrolment_code, qr_png, qr_svg
from app.people.models import Participant
from app.people.participants import COLUMNS, ParticipantChange
from app.people.schemas import (
    EnrolmentCodeOut,
    ParticipantIn,
    ParticipantOut,
    ParticipantPatch,
    ParticipantRow,
    ProfileIn,
)

router = APIRouter(
    prefix="/v1/studies/{study}/participants",
    tags=["participants"],
    responses=problem_responses(401, 403, 404, 422),
)

PICTURES = ("image/svg+xml", "image/png")
CODE_RESPONSES: Responses = {
    201: {
        "model": EnrolmentCodeOut,
        "description": "The code, shown once; or only its QR code, depending on `Accept`.",
        "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in PICTURES},
    },
    **problem_responses(409),
}


@router.post("", status_code=201, responses=problem_responses(409))
def post_participant(
    study: StudyCode, body: ParticipantIn, state: State, caller: CurrentStaff, response: Response
) -> ParticipantOut:
    """Add a participant."""
    row = participants.create_participant(
        state.database,
        state.part(SecretBox),
        study_code=study,
        code=body.code,
        caller=caller,
        change=change_of(body),
    )
    response.headers["Location"] = f"/v1/studies/{study}/participants/{body.code}"
    return _render(row)


@router.get("/{participant}")
def get_participant(
    study: StudyCode, participant: ParticipantCode, state: State, _: CurrentStaff
) -> ParticipantOut:
    """A participant with the profile that reference intakes depend on."""
    return _render(participants.read_participant(state.database, study, participant))


@router.patch("/{participant}", responses=problem_responses(409))
def patch_participant(
    study: StudyCode,
    participant: ParticipantCode,
    body: ParticipantPatch,
    state: State,
    caller: CurrentStaff,
) -> ParticipantOut:
    """Change the named fields; null removes one, also of the profile."""
    return _render(
        participants.change_participant(state.database, caller, study, participant, change_of(body))
    )


@router.post(
    "/{participant}/enrolment-codes",
    status_code=201,
    response_model=EnrolmentCodeOut,
    responses=CODE_RESPONSES,
)
def post_enrolment_code(
    request: Request,
    study: StudyCode,
    participant: ParticipantCode,
    state: State,
    caller: CurrentStaff,
) -> Response:
    """Issue a one-time code for the participant's next phone, as text and as a QR code; earlier unused codes end.

    With `Accept: image/svg+xml` or `image/png` the response is only the QR code.
    """
    issued = issue_enrolment_code(
        state.database, study_code=study, participant_code=participant, caller=caller
    )
    server = server_address(request, state.settings)
    text = enrolment_text(server, issued.code)
    media_type = _preferred_picture(request.headers.get("accept", ""))
    if media_type == "image/png":
        return Response(qr_png(text), 201, media_type=media_type)
    if media_type is not None:
        return Response(qr_svg(text), 201, media_type=media_type)
    body = EnrolmentCodeOut(
        code=issued.code,
        expires_at=issued.expires_at,
        qr_text=text,
        qr_svg=qr_svg(text),
        capture_url=capture_link(server, issued.code),
    )
    return ModelResponse(body, 201)


def _preferred_picture(accept: str) -> str | None:
    """Return the first picture type that the caller accepts; None for JSON, also if any type is accepted (RFC 9110)."""
    for part in accept.split(","):
        kind = part.partition(";")[0].strip().lower()
        if kind in ("application/json", "*/*", "application/*"):
            return None
        if kind in PICTURES:
            return kind
    return None


def change_of(
    body: ParticipantIn | ParticipantPatch,
    *,
    also: Mapping[str, None] | None = None,
    sets_all: bool = False,
) -> ParticipantChange:
    """Return the change that a body describes.

    also: further keys of the profile to remove. sets_all: also COLUMNS that are not named.
    """
    return ParticipantChange(
        profile={**(also or {}), **body.profile.model_dump(exclude_unset=True, mode="json")},
        columns={
            name: getattr(body, name)
            for name in COLUMNS
            if sets_all or name in body.model_fields_set
        },
    )


def _render(participant: Participant) -> ParticipantOut:
    row = ParticipantRow.model_validate(participant, from_attributes=True)
    profile = ProfileIn.model_validate(participant.profile or {})
    return ParticipantOut(**row.model_dump(), profile=profile)
