"""/v1/meals/{meal_id}/after: metadata of an after-meal pair. Its photographs come by PUT images/{slot}."""

from datetime import UTC, datetime
from typing import Any

import anyio.to_thread
from fastapi import APIRouter, Request, Response

from app.http.metadata import read_limited, validated_with_unknown
from app.http.parameters import MealId
from app.http.problems import problem_responses
from app.http.upload import MAX_METADATA_BYTES
from app.meals.stored.meal_time import meal_time
from app.meals.upload.after_meal import AfterMetadata, SubmitAfterPair
from app.meals.upload.api import (
    SUBMIT_RESPONSES,
    camera_details,
    hint_details,
    meal_response,
    poses_details,
)
from app.meals.upload.schemas import AfterMetadataIn
from app.people.access.deps import CurrentDevice, State
from app.records.read_meal import MealView, read_meal

router = APIRouter(prefix="/v1/meals", tags=["meals"])

METADATA_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/AfterMetadataIn"}}
        },
    }
}


@router.put(
    "/{meal_id}/after",
    status_code=202,
    response_model=None,
    responses=SUBMIT_RESPONSES | problem_responses(404),
    openapi_extra=METADATA_BODY,
)
async def put_after(
    request: Request, meal_id: MealId, state: State, caller: CurrentDevice
) -> Response:
    """Say when the after-meal pair was taken and what is left where: before its second photograph, or not at all.

    Said anew it replaces what was said, as long as no photograph of the pair is stored.
    """
    checked, unknown = validated_with_unknown(
        AfterMetadataIn, await read_limited(request, MAX_METADATA_BYTES)
    )

    def work() -> tuple[bool, MealView]:
        time_zone = checked.time_zone or state.part(SubmitAfterPair).meal_time_zone(caller, meal_id)
        metadata = AfterMetadata(
            time=meal_time(checked.captured_at, time_zone, datetime.now(UTC)),
            camera=camera_details(checked.camera),
            poses=poses_details(checked.poses),
            hints=hint_details(checked.hints),
            complete=checked.complete,
            unknown=unknown,
        )
        is_new = state.part(SubmitAfterPair).announce(caller, meal_id, metadata)
        return is_new, read_meal(state.database, caller, meal_id)

    is_new, view = await anyio.to_thread.run_sync(work)
    return meal_response(view, 202 if is_new else 200)
