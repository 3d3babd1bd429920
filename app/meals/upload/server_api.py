"""/v1/server: what this server can do, for an app that may be newer or older.

Without authentication, because an app calls it before it has a token.
"""

from datetime import UTC, datetime

from fastapi import APIRouter, Request

from app import __version__
from app.http.upload import IMAGE_TYPES, MAX_METADATA_BYTES
from app.meals.upload.api import MAX_WAIT_SECONDS
from app.meals.upload.schemas import ServerLimitsOut, ServerOut
from app.people.access.deps import State
from app.records.meal_schemas import MAX_HINTS, HintIn, NewMealMetadataIn

router = APIRouter(prefix="/v1/server", tags=["health"])

FEATURES = (  # docs/apps.md describes each; app.state.features has those of extras too
    "after_meal_pairs",
    "calibrations",
    "checks",
    "declared_meals",
    "depth_maps",
    "diary",
    "events",
    "feedback",
    "hints_are_additions",
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


@router.get("")
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
