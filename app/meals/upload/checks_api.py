"""/v1/checks: check a pair while the plate is still there."""

from typing import Annotated, Any

import anyio.to_thread
from fastapi import APIRouter, Header, Request

from app.children.api_children import ApiChildren
from app.core.errors import MalformedRequestError
from app.http.metadata import validated
from app.http.problems import problem_responses
from app.http.upload import MAX_METADATA_BYTES, UploadLimits, received_parts, require_room
from app.meals.upload.api import camera_details
from app.meals.upload.check_pair import CheckedPair, CheckRequest, check_pair
from app.meals.upload.schemas import CheckMetadataIn, CheckOut, CheckProblemOut
from app.people.access.deps import CurrentDevice, State
from app.photos.slots import PAIR_SLOTS

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
                        "left": {
                            "type": "string",
                            "format": "binary",
                            "description": "JPEG, PNG, WebP or HEIC",
                        },
                        "right": {
                            "type": "string",
                            "format": "binary",
                            "description": "JPEG, PNG, WebP or HEIC",
                        },
                    },
                },
                "encoding": {"metadata": {"contentType": "application/json"}},
            }
        },
    }
}


@router.post(
    "",
    responses=problem_responses(400, 401, 403, 410, 413, 415, 422, 503),
    openapi_extra=MULTIPART_BODY,
)
async def post_check(
    request: Request,
    state: State,
    caller: CurrentDevice,
    accept_language: Annotated[
        str | None,
        Header(
            max_length=500, description="Languages of the sentences, where the metadata names none."
        ),
    ] = None,
) -> CheckOut:
    """Check a pair before it is sent: parts `left`, `right` and optionally `metadata`. Nothing is kept.

    A pair without a problem of severity `stop` may still fail later; one with such a problem may be sent all the same.
    """
    await anyio.to_thread.run_sync(require_room, state)
    limits = UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES)
    async with received_parts(
        request, PAIR_SLOTS, state.blobs.staging_folder(), limits, state.upload_limiter
    ) as parts:
        missing = [slot for slot in PAIR_SLOTS if slot not in parts.files]
        if missing:
            raise MalformedRequestError(
                f"The request has no part {', '.join(missing)}.", code="part_missing", parts=missing
            )
        metadata = (
            validated(CheckMetadataIn, parts.metadata)
            if parts.metadata is not None
            else CheckMetadataIn()
        )
        check_request = CheckRequest(
            marker=metadata.marker,
            camera=camera_details(metadata.camera),
            locale=metadata.locale,
            accept_language=accept_language,
        )

        def work() -> CheckedPair:
            return check_pair(
                state.database,
                state.part(ApiChildren),
                state.settings,
                caller,
                check_request,
                parts.files,
            )

        checked = await anyio.to_thread.run_sync(work)
    return CheckOut(
        ok=checked.is_ok,
        problems=[
            CheckProblemOut.model_validate(problem, from_attributes=True)
            for problem in checked.problems
        ],
        measures=dict(checked.measures),
        locale=checked.locale,
        seconds=checked.seconds,
    )
