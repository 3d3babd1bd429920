"""/v1/checks: a pair judged while the plate is still there."""

from typing import Annotated, Any

import anyio.to_thread
from fastapi import APIRouter, Header, Request

from app.children.api_children import ApiChildren
from app.core.errors import MalformedRequestError
from app.http.metadata import validated
from app.http.problems import problem_responses
from app.http.upload import MAX_METADATA_BYTES, UploadLimits, received_parts, require_room
from app.meals.models import SLOTS
from app.people.access.deps import CurrentDevice, State
from app.uploads.check_pair import CheckedPair, CheckRequest, check_pair
from app.uploads.check_schemas import CheckMetadataIn, CheckOut, CheckProblemOut

router = APIRouter(prefix="/v1/checks", tags=["checks"])

MULTIPART_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["left", "right"],
                    "properties": {
                        "metadata": {"$ref": "#/components/schemas/CheckMetadataIn"},
                        "left": {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP or HEIC"},
                        "right": {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP or HEIC"},
                    },
                },
                "encoding": {"metadata": {"contentType": "application/json"}},
            }
        },
    }
}


@router.post("", responses=problem_responses(400, 401, 403, 410, 413, 415, 422, 503), openapi_extra=MULTIPART_BODY)
async def post_check(
    request: Request,
    state: State,
    caller: CurrentDevice,
    accept_language: Annotated[
        str | None, Header(max_length=500, description="Languages of the sentences, where the metadata names none.")
    ] = None,
) -> CheckOut:
    """Judge a pair before it is sent: parts `left`, `right` and, if need be, `metadata`. Nothing is kept.

    A pair without a problem that stops it may still fail later; one with such a problem may be sent all the same.
    """
    await anyio.to_thread.run_sync(require_room, state)
    limits = UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES)
    async with received_parts(request, SLOTS, state.blobs.staging_folder(), limits, state.upload_limiter) as parts:
        missing = [slot for slot in SLOTS if slot not in parts.files]
        if missing:
            raise MalformedRequestError(
                f"The request has no part {', '.join(missing)}.", code="part_missing", parts=missing
            )
        told = validated(CheckMetadataIn, parts.metadata) if parts.metadata is not None else CheckMetadataIn()
        wanted = CheckRequest(
            marker=told.marker,
            camera=told.camera.model_dump(mode="json") if told.camera is not None else None,
            locale=told.locale,
            accept_language=accept_language,
        )

        def work() -> CheckedPair:
            return check_pair(state.database, state.part(ApiChildren), state.settings, caller, wanted, parts.files)

        found = await anyio.to_thread.run_sync(work)
    return CheckOut(
        ok=found.is_ok,
        problems=[
            CheckProblemOut.model_validate(
                {"code": one.code, "severity": one.severity, "side": one.side, "message": one.message}
            )
            for one in found.problems
        ],
        measures=dict(found.measures),
        locale=found.locale,
        seconds=found.seconds,
    )
