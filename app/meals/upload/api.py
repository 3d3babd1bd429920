"""/v1/meals: a phone sends a meal, whole or part by part, and reads its state."""

import uuid
from collections.abc import Awaitable, Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, cast

import anyio.to_thread
from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import JsonValue

from app.core.errors import MalformedRequestError
from app.http.closing_stream import ClosingStream
from app.http.conditions import is_held
from app.http.metadata import read_limited, validated_with_unknown
from app.http.model_response import ModelResponse
from app.http.parameters import MealId, OfWhichParticipant, Slot
from app.http.problems import problem_responses
from app.http.state import ApiState
from app.http.upload import (
    MAX_METADATA_BYTES,
    ReceivedFile,
    UploadLimits,
    received_body,
    received_parts,
    require_room,
)
from app.meals.stored.item_state import REMEASURING
from app.meals.stored.meal_time import meal_time
from app.meals.stored.models import DepthCameraDetails, HintDetails, PosesDetails
from app.meals.stored.queries import WAITING
from app.meals.upload.after_meal import SubmitAfterPair
from app.meals.upload.submit_meal import MealMetadata, SubmitMeal
from app.meals.upload.waiting import MealWaiter
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentCaller, CurrentDevice, State
from app.people.calibrate_device import rig_details
from app.people.calibration_models import CameraDetails
from app.people.calibration_schemas import CameraIn
from app.photos.slots import AFTER_SLOTS, DEPTH_SLOTS, PAIR_SLOTS, VIEW_SLOTS, VOICE_NOTE
from app.photos.voice_note import MAX_NOTE_BYTES
from app.records.meal_schemas import HintIn, MealMetadataIn, MealOut, NewMealMetadataIn, PosesIn
from app.records.read_meal import MealView, open_artefact, read_meal
from app.records.render import render_meal
from app.vision.known_poses import poses_from_mapping
from app.vision.marker_spec import parse_marker

router = APIRouter(prefix="/v1/meals", tags=["meals"])

# heeds fields of a new meal's metadata that no model has, and takes them out of these; refuses the
# call, or returns how the meal's estimate is to end
MetadataHook = Callable[
    [Request, DeviceCaller, uuid.UUID, dict[str, JsonValue]], Awaitable[str | None]
]
FINAL = frozenset(
    {"estimated", "needs_review", "failed", "confirmed"}
)  # statuses that no worker changes
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
                    "required": ["metadata", "left"],
                    "properties": {
                        "metadata": {"$ref": "#/components/schemas/NewMealMetadataIn"},
                        **{
                            slot: {
                                "type": "string",
                                "format": "binary",
                                "description": "JPEG, PNG, WebP or HEIC",
                            }
                            for slot in VIEW_SLOTS
                        },
                        **{
                            slot: {
                                "type": "string",
                                "format": "binary",
                                "description": "PNG or TIFF",
                            }
                            for slot in DEPTH_SLOTS
                        },
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
        "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/MealMetadataIn"}}
        },
    }
}
# one media type: generators of clients do not handle several types of binary bodies
PHOTO_BODY = {
    "requestBody": {
        "required": True,
        "description": "Bytes of a JPEG, PNG, WebP or HEIC, of a map PNG or TIFF; they tell the format. `image/jpeg` "
        "is accepted too.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post(
    "",
    status_code=202,
    response_model=MealOut,
    responses=SUBMIT_RESPONSES,
    openapi_extra=MULTIPART_BODY,
)
async def post_meal(request: Request, state: State, caller: CurrentDevice) -> Response:
    """Send a meal whole: parts `metadata` (JSON, with the id that the phone made), `left` and `right`.

    With `views` in the metadata, `left` alone (1), or also `view3` up to that number. With `depth_camera`, also
    `left_depth`, or the maps that `depth_maps` names.

    The same request again gives 200 and the same answer, so a phone that did not hear the answer just sends again.
    """
    await anyio.to_thread.run_sync(require_room, state)
    async with received_parts(
        request,
        (*VIEW_SLOTS, *DEPTH_SLOTS),
        state.blobs.staging_folder(),
        _limits(state),
        state.upload_limiter,
    ) as parts:
        if parts.metadata is None:
            raise _part_missing(
                ["metadata", *(slot for slot in PAIR_SLOTS if slot not in parts.files)]
            )
        checked, unknown = validated_with_unknown(NewMealMetadataIn, parts.metadata)
        announced = (*VIEW_SLOTS[: checked.views], *checked.announced_maps)
        missing = [slot for slot in announced if slot not in parts.files]
        if missing:
            raise _part_missing(missing)
        outcome = await _wanted_outcome(request, caller, checked.id, unknown)
        metadata = _metadata(checked.id, checked, unknown, outcome)
        return await _submit(state, caller, checked.id, metadata, parts.files)


@router.put(
    "/{meal_id}",
    status_code=202,
    response_model=MealOut,
    responses=SUBMIT_RESPONSES,
    openapi_extra=METADATA_BODY,
)
async def put_meal(
    request: Request, meal_id: MealId, state: State, caller: CurrentDevice
) -> Response:
    """Announce a meal, to send its photographs one by one."""
    checked, unknown = validated_with_unknown(
        MealMetadataIn, await read_limited(request, MAX_METADATA_BYTES)
    )
    outcome = await _wanted_outcome(request, caller, meal_id, unknown)
    metadata = _metadata(meal_id, checked, unknown, outcome)
    return await _submit(state, caller, meal_id, metadata, {})


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
    """Send one photograph of an announced meal as the body. The last of the announced photographs queues it.

    A map (left_depth, ...) is announced and sent like a photograph. after_left and after_right are what was left of the
    meal; they may come at any time, also long after it.
    """
    await anyio.to_thread.run_sync(require_room, state)
    staging = state.blobs.staging_folder()
    limits = UploadLimits(photo_limit(state, slot), MAX_METADATA_BYTES)
    async with received_body(request, slot, staging, limits, state.upload_limiter) as file:
        return await submit_photograph(state, caller, meal_id, slot, file)


@router.get(
    "/{meal_id}",
    response_model=MealOut,
    responses={
        304: {"description": "The caller has this version."},
        **problem_responses(401, 404, 409, 422),
    },
)
async def get_meal(
    request: Request,
    meal_id: MealId,
    state: State,
    caller: CurrentCaller,
    wait: Annotated[
        float,
        Query(ge=0, le=MAX_WAIT_SECONDS, description="Wait up to so many seconds for a change."),
    ] = 0,
    participant: OfWhichParticipant = None,
) -> Response:
    """How a meal stands: what has arrived, its status and, once estimated, its foods: volumes, mass, nutrients.

    With `wait` the answer comes when its status or stage, or its after-meal pair's, changes, or when the time is up.
    With `If-None-Match` it also comes at once if the meal is no longer at that ETag.
    """
    view = await anyio.to_thread.run_sync(read_meal, state.database, caller, meal_id, participant)
    etags = request.headers.get("if-none-match")
    if wait and will_change(view) and (etags is None or is_held(etags, _etag(view))):
        await state.part(MealWaiter).wait(view.meal.id, view.meal.version, wait)
        view = await anyio.to_thread.run_sync(
            read_meal, state.database, caller, meal_id, participant
        )
    if etags is not None and is_held(etags, _etag(view)):
        return Response(status_code=304, headers={"ETag": _etag(view)})
    return meal_response(view, 200)


@router.get(
    "/{meal_id}/artefacts/{name}",
    response_class=StreamingResponse,
    responses=ARTEFACT_RESPONSES,
)
def get_artefact(
    meal_id: MealId,
    name: Annotated[
        str, Path(max_length=64, description="The artefact's name, as the run lists it.")
    ],
    state: State,
    caller: CurrentCaller,
    participant: OfWhichParticipant = None,
    pair: Annotated[
        Literal["meal", "after"], Query(description="Of the run on which pair.")
    ] = "meal",
) -> StreamingResponse:
    """A picture, the point cloud or the scene of the last run on the meal's pair, or on its after-meal pair."""
    artefact, content = open_artefact(
        state.database, state.blobs, caller, meal_id, name, participant, pair
    )
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


def _part_missing(parts: list[str]) -> MalformedRequestError:
    return MalformedRequestError(
        f"The request has no part {', '.join(parts)}. To send part by part, use PUT /v1/meals/{{id}}.",
        code="part_missing",
        parts=parts,
    )


async def _wanted_outcome(
    request: Request, caller: DeviceCaller, client_id: uuid.UUID, unknown: dict[str, JsonValue]
) -> str | None:
    hook: MetadataHook | None = request.app.state.on_metadata
    return await hook(request, caller, client_id, unknown) if hook is not None else None


def _metadata(
    client_id: uuid.UUID,
    checked: MealMetadataIn,
    unknown: Mapping[str, JsonValue],
    wanted_outcome: str | None,
) -> MealMetadata:
    """Raises InvalidInputError (time, zone, marker, rig, poses)."""
    if checked.marker is not None:
        parse_marker(checked.marker)
    return MealMetadata(
        client_id=client_id,
        time=meal_time(checked.captured_at, checked.time_zone, datetime.now(UTC)),
        marker=checked.marker,
        camera=camera_details(checked.camera),
        rig=rig_details(checked.rig) if checked.rig is not None else None,
        poses=poses_details(checked.poses),
        hints=hint_details(checked.hints),
        complete=checked.complete,
        views=checked.views,
        depth_camera=cast(DepthCameraDetails, checked.depth_camera.model_dump())
        if checked.depth_camera
        else None,
        depth_maps=tuple(checked.announced_maps),
        location=checked.location.model_dump(exclude_none=True) if checked.location else None,
        app_version=checked.app_version,
        unknown=unknown,
        wanted_outcome=wanted_outcome,
    )


def camera_details(camera: CameraIn | None) -> CameraDetails | None:
    """Return a request's camera as stored."""
    return cast(CameraDetails, camera.model_dump(mode="json")) if camera is not None else None


def poses_details(poses: PosesIn | None) -> PosesDetails | None:
    """Return a request's poses as stored. Raises InvalidInputError (`poses_invalid`)."""
    if poses is None:
        return None
    details = poses.model_dump(mode="json")
    poses_from_mapping(details)
    return cast(PosesDetails, details)


def hint_details(hints: Sequence[HintIn]) -> tuple[HintDetails, ...]:
    """Return a request's hints as stored."""
    return tuple(
        cast(HintDetails, hint.model_dump(mode="json", exclude_none=True, by_alias=True))
        for hint in hints
    )


def photo_limit(state: ApiState, slot: str) -> int:
    """Return the most bytes of a slot's photograph, map or voice note."""
    most = state.settings.max_photo_bytes
    return min(most, MAX_NOTE_BYTES) if slot == VOICE_NOTE else most


async def submit_photograph(
    state: ApiState, caller: DeviceCaller, client_id: uuid.UUID, slot: str, file: ReceivedFile
) -> Response:
    """Take one photograph of an announced meal or of its after-meal pair; return the meal."""
    if slot in AFTER_SLOTS:
        return await _submit_after(state, caller, client_id, {slot: file})
    return await _submit(state, caller, client_id, None, {slot: file})


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
        is_new = state.part(SubmitAfterPair).receive(caller, client_id, files)
        return is_new, read_meal(state.database, caller, client_id)

    is_new, view = await anyio.to_thread.run_sync(work, limiter=state.upload_limiter)
    return meal_response(view, 202 if is_new else 200)


def will_change(view: MealView) -> bool:
    """Whether a worker will change the meal, its after-meal pair or an item, or photographs of the meal are missing."""
    is_remeasured = any(REMEASURING in item.record.flags for item in view.items)
    return view.meal.status not in FINAL or view.meal.after_status in WAITING or is_remeasured


def meal_response(view: MealView, status: int) -> ModelResponse:
    """Return a meal with its ETag; with status 202 also its Location."""
    headers = {"ETag": _etag(view)}
    if status == 202:
        headers["Location"] = f"/v1/meals/{view.meal.client_id}"
    return ModelResponse(render_meal(view), status_code=status, headers=headers)


def _etag(view: MealView) -> str:
    return f'"{view.meal.version}"'


def _limits(state: ApiState) -> UploadLimits:
    return UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES)
