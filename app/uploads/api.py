"""/v1/meals: a phone sends a meal, whole or part by part, and asks how it stands."""

import uuid
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import anyio.to_thread
from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import JSONResponse, StreamingResponse

from app.core.errors import MalformedRequestError
from app.http.closing_stream import ClosingStream
from app.http.conditions import is_held
from app.http.metadata import read_limited
from app.http.parameters import MealId, OfWhichParticipant, Slot
from app.http.problems import problem_responses
from app.http.state import ApiState
from app.http.upload import MAX_METADATA_BYTES, ReceivedFile, UploadLimits, received_body, received_parts, require_room
from app.meals.item_state import REMEASURING
from app.meals.models import AFTER_SLOTS, SLOTS
from app.meals.queries import WAITING
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentCaller, CurrentDevice, State
from app.records.meal_schemas import MealOut
from app.records.read_meal import MealView, open_artefact, read_meal
from app.records.render import render_meal
from app.uploads.after_meal import SubmitAfterPair
from app.uploads.metadata import parse_metadata, parse_new_meal
from app.uploads.submit_meal import MealMetadata, SubmitMeal
from app.uploads.waiting import MealWaiter

router = APIRouter(prefix="/v1/meals", tags=["meals"])

FINAL = frozenset({"estimated", "needs_review", "failed", "confirmed"})  # nothing changes by itself any more
MAX_WAIT_SECONDS = 60

SUBMIT_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": MealOut, "description": "The same as before: nothing was added."},
    202: {"model": MealOut, "description": "Kept; Location names the meal."},
    **problem_responses(400, 401, 403, 409, 410, 413, 415, 422, 503),
}
MULTIPART_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["metadata", "left", "right"],
                    "properties": {
                        "metadata": {"$ref": "#/components/schemas/NewMealMetadataIn"},
                        "left": {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP or HEIC"},
                        "right": {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP or HEIC"},
                    },
                },
                "encoding": {"metadata": {"contentType": "application/json"}},
            }
        },
    }
}
ARTEFACT_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {"image/jpeg": {}, "application/json": {}, "application/octet-stream": {}},
        "description": "The picture, the points, or the scene (docs/volume.md).",
    },
    **problem_responses(401, 404, 409, 422),
}
METADATA_BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/MealMetadataIn"}}},
    }
}
# one type, for a generator of clients makes nothing of several kinds of bytes
PHOTO_BODY = {
    "requestBody": {
        "required": True,
        "description": "Bytes of a JPEG, PNG, WebP or HEIC, which tell what they are; `image/jpeg` is taken, too.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post("", status_code=202, response_model=MealOut, responses=SUBMIT_RESPONSES, openapi_extra=MULTIPART_BODY)
async def post_meal(request: Request, state: State, caller: CurrentDevice) -> Response:
    """Send a meal whole: parts `metadata` (JSON, with the id that the phone made), `left` and `right`.

    The same request again gives 200 and the same answer, so a phone that did not hear the answer just sends again.
    """
    await anyio.to_thread.run_sync(require_room, state)
    async with received_parts(
        request, SLOTS, state.blobs.staging_folder(), _limits(state), state.upload_limiter
    ) as parts:
        missing = [slot for slot in SLOTS if slot not in parts.files]
        if parts.metadata is None or missing:
            missing = missing if parts.metadata is not None else ["metadata", *missing]
            raise MalformedRequestError(
                f"The request has no part {', '.join(missing)}. To send part by part, use PUT /v1/meals/{{id}}.",
                code="part_missing",
                parts=missing,
            )
        metadata = parse_new_meal(parts.metadata)
        return await _submit(state, caller, metadata.client_id, metadata, parts.files)


@router.put(
    "/{meal_id}", status_code=202, response_model=MealOut, responses=SUBMIT_RESPONSES, openapi_extra=METADATA_BODY
)
async def put_meal(request: Request, meal_id: MealId, state: State, caller: CurrentDevice) -> Response:
    """Announce a meal, to send its photographs one by one."""
    body = await read_limited(request, MAX_METADATA_BYTES)
    return await _submit(state, caller, meal_id, parse_metadata(meal_id, body), {})


@router.put(
    "/{meal_id}/images/{slot}",
    status_code=202,
    response_model=MealOut,
    responses=SUBMIT_RESPONSES | problem_responses(404),
    openapi_extra=PHOTO_BODY,
)
async def put_photograph(
    request: Request,
    meal_id: MealId,
    slot: Slot,
    state: State,
    caller: CurrentDevice,
) -> Response:
    """Send one photograph of an announced meal as the body. The last of a pair queues it.

    after_left and after_right are what was left of the meal; they may come at any time, also long after it.
    """
    await anyio.to_thread.run_sync(require_room, state)
    staging = state.blobs.staging_folder()
    async with received_body(request, slot, staging, _limits(state), state.upload_limiter) as file:
        if slot in AFTER_SLOTS:
            return await _submit_after(state, caller, meal_id, {slot: file})
        return await _submit(state, caller, meal_id, None, {slot: file})


@router.get(
    "/{meal_id}",
    response_model=MealOut,
    responses={304: {"description": "The caller has this version."}, **problem_responses(401, 404, 409, 422)},
)
async def get_meal(
    request: Request,
    meal_id: MealId,
    state: State,
    caller: CurrentCaller,
    wait: Annotated[
        float, Query(ge=0, le=MAX_WAIT_SECONDS, description="Wait up to so many seconds for a change.")
    ] = 0,
    participant: OfWhichParticipant = None,
) -> Response:
    """How a meal stands: what has arrived, its status and, once estimated, its foods: volumes, mass, nutrients.

    With `wait` the answer comes when its status or stage, or its after-meal pair's, changes, or when the time is up.
    With `If-None-Match` it also comes at once if the meal is no longer at that ETag.
    """
    view = await anyio.to_thread.run_sync(read_meal, state.database, caller, meal_id, participant)
    known = request.headers.get("if-none-match")
    if wait and will_change(view) and (known is None or is_held(known, _etag(view))):
        await state.part(MealWaiter).wait(view.meal.id, view.meal.version, wait)
        view = await anyio.to_thread.run_sync(read_meal, state.database, caller, meal_id, participant)
    if known is not None and is_held(known, _etag(view)):
        return Response(status_code=304, headers={"ETag": _etag(view)})
    return meal_response(view, 200)


@router.get(
    "/{meal_id}/artefacts/{name}",
    response_class=StreamingResponse,
    responses=ARTEFACT_RESPONSES,
)
def get_artefact(
    meal_id: MealId,
    name: Annotated[str, Path(max_length=64, description="The artefact's name, as the run lists it.")],
    state: State,
    caller: CurrentCaller,
    participant: OfWhichParticipant = None,
    pair: Annotated[Literal["meal", "after"], Query(description="Of the run on which pair.")] = "meal",
) -> StreamingResponse:
    """A picture, the point cloud or the scene of the last run on the meal's pair, or on its after-meal pair."""
    artefact, content = open_artefact(state.database, state.blobs, caller, meal_id, name, participant, pair)
    return ClosingStream(
        content,
        content.close,
        media_type=artefact.media_type,
        headers={
            "Content-Length": str(artefact.bytes),
            "ETag": f'"{artefact.sha256}"',
            "Cache-Control": "private, max-age=86400, immutable",
        },
    )


async def _submit(
    state: ApiState,
    caller: DeviceCaller,
    client_id: uuid.UUID,
    metadata: MealMetadata | None,
    files: Mapping[str, ReceivedFile],
) -> Response:
    def work() -> tuple[bool, MealView]:
        submitted = state.part(SubmitMeal).submit(caller, client_id, metadata, files)
        return submitted.is_new, submitted.view or read_meal(state.database, caller, client_id)

    is_new, view = await anyio.to_thread.run_sync(work, limiter=state.upload_limiter)
    return meal_response(view, 202 if is_new else 200)


async def _submit_after(
    state: ApiState, caller: DeviceCaller, client_id: uuid.UUID, files: Mapping[str, ReceivedFile]
) -> Response:
    def work() -> tuple[bool, MealView]:
        submitted = state.part(SubmitAfterPair).receive(caller, client_id, files)
        return submitted.is_new, read_meal(state.database, caller, client_id)

    is_new, view = await anyio.to_thread.run_sync(work, limiter=state.upload_limiter)
    return meal_response(view, 202 if is_new else 200)


def will_change(view: MealView) -> bool:
    """Whether a worker will move the meal, its after-meal pair or an item on, or photographs the meal."""
    is_measured_anew = any(REMEASURING in item.record.flags for item in view.items)
    return view.meal.status not in FINAL or view.meal.after_status in WAITING or is_measured_anew


def meal_response(view: MealView, status: int) -> JSONResponse:
    """A meal with its ETag; 202 also tells where it is."""
    headers = {"ETag": _etag(view)}
    if status == 202:
        headers["Location"] = f"/v1/meals/{view.meal.client_id}"
    return JSONResponse(render_meal(view).model_dump(mode="json"), status_code=status, headers=headers)


def _etag(view: MealView) -> str:
    return f'"{view.meal.version}"'


def _limits(state: ApiState) -> UploadLimits:
    return UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES)
