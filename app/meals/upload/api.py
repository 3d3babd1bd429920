"""A phone sends a meal: /v1/meals, whole or part by part, its after-meal pair, or foods alone.

Photographs and what is known of them come in any order that the phone needs; what is sent again
gives the same answer.
"""

import uuid
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import anyio.to_thread
from fastapi import APIRouter, Request, Response
from pydantic import JsonValue

from app.core.errors import MalformedRequestError
from app.http.metadata import read_limited, validated_with_unknown
from app.http.model_response import ModelResponse
from app.http.parameters import MealId, Slot
from app.http.problems import Responses, problem_responses
from app.http.state import ApiState
from app.http.upload import (
    MAX_METADATA_BYTES,
    ReceivedFile,
    UploadLimits,
    received_body,
    received_parts,
    require_room,
)
from app.meals.upload.after_meal import SubmitAfterPair
from app.meals.upload.declare_meal import DeclareMeal
from app.meals.upload.meal_draft import MealDraft, draft_meal
from app.meals.upload.schemas import AfterMetadataIn, DeclaredMealIn, FavouriteList
from app.meals.upload.submit_meal import SubmitMeal
from app.people.access import audit
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentDevice, State
from app.people.devices import read_phone
from app.people.participants import require_in_study
from app.photos.slots import AFTER_SLOTS, DEPTH_SLOTS, PAIR_SLOTS, VIEW_SLOTS, VOICE_NOTE
from app.photos.voice_note import MAX_NOTE_BYTES
from app.records.meal_schemas import MealMetadataIn, MealOut, NewMealMetadataIn
from app.records.read_meal import MealView, read_meal
from app.records.render import tagged_meal

router = APIRouter(responses=problem_responses(401, 403, 410))
meals = APIRouter(
    tags=["meals"], responses=problem_responses(400, 401, 403, 409, 410, 413, 415, 422, 503)
)

# heeds fields of a new meal's metadata that no model has, and takes them out of these; refuses the
# call, or returns how the meal's estimate is to end
MetadataHook = Callable[
    [Request, DeviceCaller, uuid.UUID, dict[str, JsonValue]], Awaitable[str | None]
]

SUBMIT_RESPONSES: Responses = {
    200: {"model": MealOut, "description": "The same as before: nothing was added."},
    202: {"model": MealOut, "description": "Kept; Location names the meal."},
}
DECLARE_RESPONSES: Responses = {
    200: {"model": MealOut, "description": "The same as before: nothing was added."},
    201: {"model": MealOut, "description": "Kept and confirmed; Location names the meal."},
    **problem_responses(400, 409, 413, 422, 503),
}
PHOTOGRAPH_TYPES = "JPEG, PNG, WebP or HEIC"
MAP_TYPES = "PNG or TIFF"
# one media type: generators of clients do not handle several types of binary bodies
PHOTO_BODY = {
    "requestBody": {
        "required": True,
        "description": "Bytes of a JPEG, PNG, WebP or HEIC, of a map PNG or TIFF; they tell the format. `image/jpeg` "
        "is accepted too.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


def json_body(model: str) -> dict[str, Any]:
    """Return what OpenAPI says of a body that is read from the stream. model: its schema's name."""
    schema = {"schema": {"$ref": f"#/components/schemas/{model}"}}
    return {"requestBody": {"required": True, "content": {"application/json": schema}}}


def multipart_body(model: str, required: Sequence[str], files: Mapping[str, str]) -> dict[str, Any]:
    """Return what OpenAPI says of a multipart body.

    model: the schema's name of the part `metadata`
    files: slot -> description of its file
    """
    parts: dict[str, Any] = {"metadata": {"$ref": f"#/components/schemas/{model}"}}
    for slot, description in files.items():
        parts[slot] = {"type": "string", "format": "binary", "description": description}
    content = {
        "schema": {"type": "object", "required": list(required), "properties": parts},
        "encoding": {"metadata": {"contentType": "application/json"}},
    }
    return {"requestBody": {"required": True, "content": {"multipart/form-data": content}}}


MEAL_FILES = dict.fromkeys(VIEW_SLOTS, PHOTOGRAPH_TYPES) | dict.fromkeys(DEPTH_SLOTS, MAP_TYPES)


@meals.post(
    "/v1/meals",
    status_code=202,
    response_model=MealOut,
    responses=SUBMIT_RESPONSES,
    openapi_extra=multipart_body("NewMealMetadataIn", ["metadata", "left"], MEAL_FILES),
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
        tuple(MEAL_FILES),
        state.blobs.staging_folder(),
        UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES),
        state.upload_limiter,
    ) as parts:
        if parts.metadata is None:
            missing = [slot for slot in PAIR_SLOTS if slot not in parts.files]
            raise _part_missing(["metadata", *missing])
        checked, unknown = validated_with_unknown(NewMealMetadataIn, parts.metadata)
        announced = (*VIEW_SLOTS[: checked.views], *checked.announced_maps)
        missing = [slot for slot in announced if slot not in parts.files]
        if missing:
            raise _part_missing(missing)
        draft = await _draft(request, caller, checked.id, checked, unknown)
        return await _submit(state, caller, checked.id, draft, parts.files)


@meals.put(
    "/v1/meals/{meal_id}",
    status_code=202,
    response_model=MealOut,
    responses=SUBMIT_RESPONSES,
    openapi_extra=json_body("MealMetadataIn"),
)
async def put_meal(
    request: Request, meal_id: MealId, state: State, caller: CurrentDevice
) -> Response:
    """Announce a meal, to send its photographs one by one."""
    body = await read_limited(request, MAX_METADATA_BYTES)
    checked, unknown = validated_with_unknown(MealMetadataIn, body)
    draft = await _draft(request, caller, meal_id, checked, unknown)
    return await _submit(state, caller, meal_id, draft, {})


@meals.put(
    "/v1/meals/{meal_id}/images/{slot}",
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


@meals.put(
    "/v1/meals/{meal_id}/after",
    status_code=202,
    response_model=None,
    responses=SUBMIT_RESPONSES | problem_responses(404),
    openapi_extra=json_body("AfterMetadataIn"),
)
async def put_after(
    request: Request, meal_id: MealId, state: State, caller: CurrentDevice
) -> Response:
    """Say when the after-meal pair was taken and what is left where: before its second photograph, or not at all.

    Said anew it replaces what was said, as long as no photograph of the pair is stored.
    """
    body = await read_limited(request, MAX_METADATA_BYTES)
    checked, unknown = validated_with_unknown(AfterMetadataIn, body)

    def work() -> ModelResponse:
        is_new = state.part(SubmitAfterPair).announce(caller, meal_id, checked, unknown)
        return _received(read_meal(state.database, caller, meal_id), is_new=is_new)

    return await anyio.to_thread.run_sync(work)


@router.post(
    "/v1/declared-meals",
    status_code=201,
    response_model=MealOut,
    responses=DECLARE_RESPONSES,
    tags=["review"],
)
def post_declared_meal(body: DeclaredMealIn, state: State, caller: CurrentDevice) -> ModelResponse:
    """Enter a meal without photographs: foods and amounts. From then on it is a meal like all others."""
    is_new = state.part(DeclareMeal).declare(caller, body)
    view = read_meal(state.database, caller, body.id)
    return tagged_meal(view, 201 if is_new else 200, is_located=True)


@router.get("/v1/me/favourites", tags=["review"])
def get_favourites(state: State, caller: CurrentDevice) -> FavouriteList:
    """The participant's favourites: foods and amounts under a name."""
    _, participant, _, _ = read_phone(state.database, caller)
    return FavouriteList.model_validate({"items": participant.favourites or []})


@router.put("/v1/me/favourites", responses=problem_responses(413, 422), tags=["review"])
def put_favourites(body: FavouriteList, state: State, caller: CurrentDevice) -> FavouriteList:
    """Replace all favourites of the participant."""
    with state.database.write() as session:
        participant = require_in_study(session, caller.participant_id)
        participant.favourites = body.model_dump(mode="json")["items"]
        audit.note(session, caller, "favourites.set", items=len(body.items))
    return body


def photo_limit(state: ApiState, slot: str) -> int:
    """Return the most bytes of a slot's photograph, map or voice note."""
    most = state.settings.max_photo_bytes
    return min(most, MAX_NOTE_BYTES) if slot == VOICE_NOTE else most


async def submit_photograph(
    state: ApiState, caller: DeviceCaller, client_id: uuid.UUID, slot: str, file: ReceivedFile
) -> Response:
    """Take one photograph of an announced meal or of its after-meal pair; return the meal."""
    if slot not in AFTER_SLOTS:
        return await _submit(state, caller, client_id, None, {slot: file})

    def work() -> ModelResponse:
        is_new = state.part(SubmitAfterPair).receive(caller, client_id, {slot: file})
        return _received(read_meal(state.database, caller, client_id), is_new=is_new)

    return await anyio.to_thread.run_sync(work, limiter=state.upload_limiter)


async def _submit(
    state: ApiState,
    caller: DeviceCaller,
    client_id: uuid.UUID,
    draft: MealDraft | None,
    files: Mapping[str, ReceivedFile],
) -> Response:
    def work() -> ModelResponse:
        submitted = state.part(SubmitMeal).submit(caller, client_id, draft, files)
        view = submitted.view or read_meal(state.database, caller, client_id)
        return _received(view, is_new=submitted.is_new)

    return await anyio.to_thread.run_sync(work, limiter=state.upload_limiter)


async def _draft(
    request: Request,
    caller: DeviceCaller,
    client_id: uuid.UUID,
    metadata: MealMetadataIn,
    unknown: dict[str, JsonValue],
) -> MealDraft:
    """Return the meal that the metadata describe. Raises what draft_meal and the hook raise."""
    hook: MetadataHook | None = request.app.state.on_metadata
    outcome = await hook(request, caller, client_id, unknown) if hook is not None else None
    return draft_meal(metadata, client_id, unknown, outcome)


def _received(view: MealView, *, is_new: bool) -> ModelResponse:
    return tagged_meal(view, 202 if is_new else 200, is_located=is_new)


def _part_missing(parts: list[str]) -> MalformedRequestError:
    return MalformedRequestError(
        f"The request has no part {', '.join(parts)}. To send part by part, use PUT /v1/meals/{{id}}.",
        code="part_missing",
        parts=parts,
    )


router.include_router(meals)
