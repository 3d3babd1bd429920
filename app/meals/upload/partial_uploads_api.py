"""/v1/meals/{id}/images/{slot}/upload: one photograph in several requests, by tus 1.0 (docs/apps.md).

A photograph has one upload, so its address needs no id and a phone that lost an answer still knows
it. The last byte submits the photograph as PUT does; only then is it on the server's disk.
"""

import base64
import re
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Header, Request, Response

from app.core.errors import (
    ConflictError,
    NotFoundError,
    PreconditionFailedError,
    TadaError,
    UnsupportedMediaError,
)
from app.http.parameters import MealId, Slot
from app.http.problems import problem_responses
from app.http.state import ApiState
from app.http.upload import photo_too_large, require_room
from app.meals.upload.api import photo_limit, submit_photograph
from app.meals.upload.partial_uploads import OpenUpload, PartialUploads, UploadKey, UploadState
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentDevice, State
from app.records.read_meal import read_meal

router = APIRouter(
    prefix="/v1/meals/{meal_id}/images/{slot}/upload",
    tags=["meals"],
    responses=problem_responses(401, 403, 404, 410, 412, 422),
)

TUS_VERSION = "1.0.0"
PIECE_TYPE = "application/offset+octet-stream"
TEMPORARY = 500  # from this status on a refusal is not the photograph's fault
PIECE_BODY = {
    "requestBody": {
        "required": True,
        "description": "The bytes from `Upload-Offset` on, as many as the request has.",
        "content": {PIECE_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    }
}
SHA_256 = re.compile(r"\bsha-256=:([A-Za-z0-9+/]{43}=):")  # of Repr-Digest: RFC 9530, section 3
OffsetIn = Annotated[
    int, Header(alias="Upload-Offset", ge=0, description="Where in the photograph the body begins.")
]
LengthIn = Annotated[
    int, Header(alias="Upload-Length", ge=1, description="The photograph's length in bytes.")
]
DigestIn = Annotated[
    str | None,
    Header(
        alias="Repr-Digest",
        description="The whole photograph's SHA-256, `sha-256=:BASE64:`: other bytes are refused before they are kept.",
        max_length=1000,
    ),
]
VersionIn = Annotated[
    str | None,
    Header(
        alias="Tus-Resumable", description="The version of the tus protocol: 1.0.0.", max_length=20
    ),
]


@router.post(
    "", status_code=201, response_class=Response, responses=problem_responses(409, 413, 503)
)
def post_upload(
    meal_id: MealId,
    slot: Slot,
    state: State,
    caller: CurrentDevice,
    length: LengthIn,
    version: VersionIn = None,
) -> Response:
    """Begin an upload in pieces, or start it again; the pieces go to the answer's Location."""
    _require_version(version)
    key = _upload_key(state, caller, meal_id, slot)
    require_room(state)
    if length > photo_limit(state, slot):
        raise photo_too_large(slot, photo_limit(state, slot))
    upload = state.part(PartialUploads).create(key, length)
    return _answer(201, upload, Location=f"/v1/meals/{meal_id}/images/{slot}/upload")


@router.get("", status_code=204, response_class=Response)
def get_upload(
    meal_id: MealId, slot: Slot, state: State, caller: CurrentDevice, version: VersionIn = None
) -> Response:
    """Return an upload's state in `Upload-Offset`; tus clients ask by HEAD. 404: begin one.

    Of a photograph that is on the server's disk it is the length: the answer to the last piece was lost.
    """
    _require_version(version)
    meal = read_meal(state.database, caller, meal_id)
    durable = next((image.bytes for image in meal.images if image.slot == slot), None)
    if durable is not None:
        return _answer(204, UploadState(durable, durable))
    return _answer(
        204, state.part(PartialUploads).state(UploadKey(caller.participant_id, meal_id, slot))
    )


@router.patch(
    "",
    status_code=204,
    response_class=Response,
    responses=problem_responses(400, 409, 413, 415, 503),
    openapi_extra=PIECE_BODY,
)
async def patch_upload(
    request: Request,
    meal_id: MealId,
    slot: Slot,
    state: State,
    caller: CurrentDevice,
    offset: OffsetIn,
    digest: DigestIn = None,
    version: VersionIn = None,
) -> Response:
    """Send the next piece. What arrived before a connection broke is kept: ask where to continue.

    The piece with the last byte submits the photograph and answers as `PUT` of it does, without a body. An answer
    whose `Upload-Offset` is the length means that the photograph is durable.
    """
    _require_version(version)
    if request.headers.get("content-type") != PIECE_TYPE:
        raise UnsupportedMediaError(f"Send the piece as {PIECE_TYPE}.")
    await anyio.to_thread.run_sync(require_room, state)
    key = await anyio.to_thread.run_sync(_upload_key, state, caller, meal_id, slot)
    uploads = state.part(PartialUploads)
    with uploads.opened(key, offset) as upload:
        progress = await upload.append(request.stream(), state.upload_limiter)
        if progress.offset == progress.length:
            await _submit(state, caller, key, upload, digest)
    return _answer(204, progress)


@router.delete("", status_code=204, response_class=Response)
def delete_upload(
    meal_id: MealId, slot: Slot, state: State, caller: CurrentDevice, version: VersionIn = None
) -> Response:
    """Give an upload up. The photograph itself, if it is already here, stays."""
    _require_version(version)
    state.part(PartialUploads).discard(_upload_key(state, caller, meal_id, slot))
    return Response(status_code=204, headers={"Tus-Resumable": TUS_VERSION})


async def _submit(
    state: ApiState,
    caller: DeviceCaller,
    key: UploadKey,
    upload: OpenUpload,
    repr_digest: str | None,
) -> None:
    """Submit the whole photograph; an upload that can never be accepted is removed, any other waits for another try."""
    uploads = state.part(PartialUploads)
    file = await anyio.to_thread.run_sync(
        upload.photograph, state.blobs.staging_folder(), limiter=state.upload_limiter
    )
    try:
        announced = SHA_256.search(repr_digest or "")
        if announced is not None and base64.b64decode(announced[1]).hex() != file.sha256:
            raise ConflictError(
                "The bytes that arrived are not those that `Repr-Digest` names: the upload is given up, begin it anew.",
                code="upload_digest_differs",
            )
        await submit_photograph(state, caller, key.meal, key.slot, file)
    except TadaError as error:
        if (
            error.status < TEMPORARY
            and not error.retryable
            and not isinstance(error, NotFoundError)
        ):
            uploads.discard(key)
        raise
    finally:
        file.path.unlink(missing_ok=True)
    uploads.discard(key)


def _upload_key(state: ApiState, caller: DeviceCaller, meal_id: MealId, slot: Slot) -> UploadKey:
    """Raises NotFoundError, GoneError: the meal must have been announced."""
    read_meal(state.database, caller, meal_id)
    return UploadKey(caller.participant_id, meal_id, slot)


def _require_version(version: str | None) -> None:
    if version is not None and version != TUS_VERSION:
        raise PreconditionFailedError(
            f"The server speaks tus {TUS_VERSION}.",
            code="tus_version_unknown",
            versions=[TUS_VERSION],
        )


def _answer(status: int, upload: UploadState, **headers: str) -> Response:
    progress = {
        "Tus-Resumable": TUS_VERSION,
        "Upload-Offset": str(upload.offset),
        "Upload-Length": str(upload.length),
        "Cache-Control": "no-store",
    }
    return Response(status_code=status, headers=progress | headers)
