"""/v1/checks: check a pair while the plate is still there. Nothing of it is kept."""

import time
from collections.abc import Mapping
from typing import Annotated, cast

import anyio.to_thread
from fastapi import APIRouter, Header, Request

from app.children.api_children import ApiChildren, Whose
from app.core.errors import InvalidInputError, MalformedRequestError
from app.http.metadata import validated
from app.http.problems import problem_responses
from app.http.state import ApiState
from app.http.upload import (
    MAX_METADATA_BYTES,
    ReceivedFile,
    UploadLimits,
    received_parts,
    require_room,
)
from app.meals.estimate.camera_choice import choose_camera
from app.meals.upload.api import PHOTOGRAPH_TYPES, multipart_body
from app.meals.upload.schemas import CheckMetadataIn, CheckOut, CheckProblemOut
from app.messages.catalogue import choose_locale, sentence
from app.people.access.caller import DeviceCaller
from app.people.access.deps import CurrentDevice, State
from app.people.models import CameraDetails, Study
from app.photos.slots import PAIR_SLOTS
from app.vision.intrinsics import camera_to_json
from app.vision.known_object import parse_scale

router = APIRouter(prefix="/v1/checks", tags=["checks"])

SECONDS = 10.0  # limit of one check: many times the need of a slow machine
FILES = dict.fromkeys(PAIR_SLOTS, PHOTOGRAPH_TYPES)


@router.post(
    "",
    responses=problem_responses(400, 401, 403, 410, 413, 415, 422, 503),
    openapi_extra=multipart_body("CheckMetadataIn", PAIR_SLOTS, FILES),
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
        metadata = validated(CheckMetadataIn, parts.metadata or b"{}")
        return await anyio.to_thread.run_sync(
            check_pair, state, caller, metadata, accept_language, parts.files
        )


def check_pair(
    state: ApiState,
    caller: DeviceCaller,
    metadata: CheckMetadataIn,
    accept_language: str | None,
    files: Mapping[str, ReceivedFile],
) -> CheckOut:
    """Check a pair; sentences are in the participant's language.

    Raises InvalidInputError (`marker_missing`), UnavailableError (`server_busy`), PhotographError.
    """
    started = time.perf_counter()
    children = state.part(ApiChildren)
    whose = Whose(caller.study_id, caller.device_id)
    inspected = children.inspect([file.path for file in files.values()], whose)
    camera = metadata.camera
    with state.database.read() as session:
        study = session.get_one(Study, caller.study_id)
        marker = metadata.marker or study.marker
        chosen = choose_camera(
            session,
            meal_camera=cast(CameraDetails, camera.model_dump()) if camera is not None else None,
            device_id=caller.device_id,
            study=study,
            sizes=inspected.sizes or [(1, 1)],
        )
    if marker is None:
        raise InvalidInputError(
            "Neither the metadata nor the study says which marker lies beside the plate: send "
            "marker, such as plain:9x7:11.",
            code="marker_missing",
        )
    parse_scale(marker)
    locale = choose_locale(metadata.locale, accept_language, study.locale)
    request = {
        "left": str(files["left"].path),
        "right": str(files["right"].path),
        "marker": marker,
        "camera": camera_to_json(chosen.camera) if chosen.camera is not None else None,
        "max_pixels": state.settings.max_photo_pixels,
    }
    result = children.run(
        "check", request, seconds=SECONDS, whose=whose, is_costly=inspected.is_costly
    )
    problems = [
        CheckProblemOut(
            **problem,
            message=sentence(problem["code"], locale, problem["side"]) or problem["code"],
        )
        for problem in result["problems"]
    ]
    return CheckOut(
        ok=result["ok"],
        problems=problems,
        measures=result["measures"],
        locale=locale,
        seconds=round(time.perf_counter() - started, 3),
    )
