"""/v1/packaged-foods and /v1/barcodes: a packaged food by its barcode, typed or photographed. Nothing is kept."""

from dataclasses import asdict
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Path, Request

from app.children.api_children import ApiChildren, PhotographError, Whose
from app.core.errors import InvalidInputError
from app.foods.packaged.packaged_foods import PackagedView, read_packaged
from app.foods.packaged.schemas import PackagedFoodOut, PackagedSourceOut
from app.http.problems import problem_responses
from app.http.state import ApiState
from app.http.upload import (
    MAX_METADATA_BYTES,
    ReceivedFile,
    UploadLimits,
    received_body,
    require_room,
)
from app.meals.upload.api import PHOTO_BODY
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentCaller, CurrentDevice, State

router = APIRouter(tags=["foods"], responses=problem_responses(401, 404, 422))

SECONDS = 10.0  # limit of one photograph: many times the need of a slow machine


@router.get("/v1/packaged-foods/{barcode}")
def get_packaged_food(
    state: State,
    _: CurrentCaller,
    barcode: Annotated[
        str, Path(max_length=14, description="The digits under the bars: 8, 12, 13 or 14.")
    ],
) -> PackagedFoodOut:
    """A packaged food of Open Food Facts' dump, by its barcode."""
    return render_packaged(read_packaged(state.database, barcode))


@router.post(
    "/v1/barcodes",
    responses=problem_responses(400, 403, 410, 413, 415, 503),
    openapi_extra=PHOTO_BODY,
)
async def post_barcode(request: Request, state: State, caller: CurrentDevice) -> PackagedFoodOut:
    """Read the barcode in a photograph of a pack, and answer with its food. Nothing is kept."""
    await anyio.to_thread.run_sync(require_room, state)
    limits = UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES)
    staging = state.blobs.staging_folder()
    async with received_body(request, "pack", staging, limits, state.upload_limiter) as file:
        return await anyio.to_thread.run_sync(_read_pack, state, caller, file)


def _read_pack(state: ApiState, caller: DeviceCaller, file: ReceivedFile) -> PackagedFoodOut:
    """Raise InvalidInputError (`barcode_not_found`, `barcodes_several`), PhotographError, as read_packaged."""
    children, whose = state.part(ApiChildren), Whose(caller.study_id, caller.device_id)
    inspected = children.inspect([file.path], whose)
    request = {"photo": str(file.path), "max_pixels": state.settings.max_photo_pixels}
    answer = children.run(
        "barcode", request, seconds=SECONDS, whose=whose, is_costly=inspected.is_costly
    )
    if answer["failure"] is not None:
        raise PhotographError(answer["failure"]["message"], code=answer["failure"]["code"])
    barcodes = answer["barcodes"]
    if not barcodes:
        raise InvalidInputError(
            "No barcode can be read in the photograph: go nearer and hold the phone still, or type its digits.",
            code="barcode_not_found",
        )
    if len(barcodes) > 1:
        raise InvalidInputError(
            "There are several barcodes in the photograph: choose one, or photograph one alone.",
            code="barcodes_several",
            barcodes=barcodes,
        )
    return render_packaged(read_packaged(state.database, barcodes[0]))


def render_packaged(view: PackagedView) -> PackagedFoodOut:
    """Return a packaged food as the API shows it."""
    food, digits = view.food, view.food.source_ids["gtin"]
    return PackagedFoodOut.model_validate(
        {
            "key": food.key,
            "name": food.name,
            "barcode": digits,
            "measured_in": "ml" if view.row.is_liquid else "g",
            "nutrients": [
                asdict(COMPONENT_BY_NUMBER[number]) | {"per_100_g": value}
                for number, value in food.per_100_g.items()
            ],
            "portions": [asdict(portion) for portion in food.portions],
            "source": PackagedSourceOut(
                name="Open Food Facts",
                release=view.release.title,
                licence="ODbL 1.0",
                url=f"https://world.openfoodfacts.org/product/{digits}",
            ),
        }
    )
