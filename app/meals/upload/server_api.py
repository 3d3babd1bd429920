"""What an app asks at its start: /v1/server, what this server can do; /v1/me, whose phone it is.

An app may be newer or older than the server. It asks what the server can do before it has a token.
"""

from datetime import UTC, datetime

from fastapi import APIRouter, Request, Response

from app import __version__
from app.http.problems import problem_responses
from app.http.upload import IMAGE_TYPES, MAX_METADATA_BYTES
from app.meals.upload.read_api import MAX_WAIT_SECONDS
from app.meals.upload.schemas import ServerLimitsOut, ServerOut
from app.people import devices
from app.people.access.deps import CurrentDevice, State
from app.people.schemas import MeOut, PhoneOut, PhoneProtocol
from app.people.studies_api import render_study
from app.records.meal_schemas import MAX_HINTS, HintIn, NewMealMetadataIn

router = APIRouter()

FEATURES = (  # docs/apps.md describes each; app.state.features has those of extras too
    "after_meal_pairs",
    "calibrations",
    "checks",
    "declared_meals",
    "depth_maps",
    "diary",
    "events",
    "favourites",
    "feedback",
    "hints_are_additions",
    "packaged_foods",
    "parts",
    "poses",
    "questions",
    "repeatable_enrolment",
    "resumable_uploads",
    "rigs",
    "unknown_fields",
    "vessels",
    "voice_notes",
)


@router.get("/v1/server", tags=["health"])
def get_server(request: Request, state: State) -> ServerOut:
    """The server's version, what it reads and knows, and its limits."""
    settings = state.settings
    return ServerOut(
        version=__version__,
        api_versions=["v1"],
        time=datetime.now(UTC),
        image_types=list(IMAGE_TYPES),
        metadata_fields=sorted(NewMealMetadataIn.model_fields),
        hint_fields=sorted(HintIn.model_fields),
        features=sorted(request.app.state.features),
        limits=ServerLimitsOut(
            photo_bytes=settings.max_photo_bytes,
            photo_pixels=settings.max_photo_pixels,
            metadata_bytes=MAX_METADATA_BYTES,
            hints=MAX_HINTS,
            wait_seconds=MAX_WAIT_SECONDS,
        ),
    )


@router.get("/v1/me", tags=["me"], responses=problem_responses(401, 403, 410))
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


@router.delete(
    "/v1/me/device", tags=["me"], status_code=204, responses=problem_responses(401, 403, 410)
)
def delete_my_device(state: State, caller: CurrentDevice) -> Response:
    """Sign the phone out: its token is no longer valid. What it sent is kept."""
    devices.sign_out_phone(state.database, caller)
    return Response(status_code=204)
