"""/v1/calibrations, /v1/rigs: measure a phone's camera from photographs of the board, or keep a stereo rig."""

import uuid
from datetime import datetime
from typing import Annotated, Any, Literal, TypedDict

import anyio.to_thread
from fastapi import APIRouter, Path, Query, Request

from app.children.api_children import ApiChildren
from app.http.flat_list import ListRoute
from app.http.metadata import validated
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.http.text_schemas import Text
from app.http.upload import MAX_METADATA_BYTES, UploadLimits, received_parts, require_room
from app.people import calibrate_device
from app.people.access.deps import CurrentCaller, CurrentDevice, CurrentStaff, State
from app.people.calibrate_device import MAX_PHOTOGRAPHS, NewCalibration
from app.people.calibration_schemas import (
    CalibrationList,
    CalibrationMetadataIn,
    CalibrationOut,
    CameraIn,
    LeftOutPhotographOut,
    NewCalibrationOut,
    RigIn,
    RigOut,
    StudyCalibrationList,
    StudyCalibrationOut,
)
from app.people.models import CameraCalibration

router = APIRouter(
    tags=["calibrations"], route_class=ListRoute, responses=problem_responses(401, 403)
)

PHOTO = "photo"
MULTIPART_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": [PHOTO],
                    "properties": {
                        "metadata": {"$ref": "#/components/schemas/CalibrationMetadataIn"},
                        PHOTO: {
                            "type": "array",
                            "minItems": calibrate_device.MIN_PHOTOGRAPHS,
                            "maxItems": MAX_PHOTOGRAPHS,
                            "items": {
                                "type": "string",
                                "format": "binary",
                                "description": "JPEG, PNG, WebP or HEIC",
                            },
                        },
                    },
                },
                "encoding": {"metadata": {"contentType": "application/json"}},
            }
        },
    }
}


@router.post(
    "/v1/calibrations",
    status_code=201,
    responses=problem_responses(400, 409, 410, 413, 415, 422, 503),
    openapi_extra=MULTIPART_BODY,
)
async def post_calibration(
    request: Request, state: State, caller: CurrentDevice
) -> NewCalibrationOut:
    """Measure this phone's camera: 3 to 30 parts `photo` of the whole board from different sides, and `metadata`.

    Ten are enough: tilted by 30 to 45 degrees, near the middle and near the corners. The photographs are not kept.
    """
    await anyio.to_thread.run_sync(require_room, state)
    limits = UploadLimits(state.settings.max_photo_bytes, MAX_METADATA_BYTES)
    staging = state.blobs.staging_folder()
    async with received_parts(
        request, (PHOTO,), staging, limits, state.upload_limiter, times=MAX_PHOTOGRAPHS
    ) as parts:
        metadata = (
            validated(CalibrationMetadataIn, parts.metadata) if parts.metadata is not None else None
        )
        marker = metadata.marker if metadata is not None else None

        def work() -> NewCalibration:
            return calibrate_device.calibrate_device(
                state.database,
                state.part(ApiChildren),
                state.settings,
                caller,
                marker,
                list(parts.files.values()),
            )

        new = await anyio.to_thread.run_sync(work)
    left_out = [
        LeftOutPhotographOut(
            photograph=rejected.photo + 1, code=rejected.code, message=rejected.message
        )
        for rejected in new.rejected
    ]
    return NewCalibrationOut(**_fields(new.calibration), left_out=left_out)


@router.get("/v1/calibrations", responses=problem_responses(410))
def get_own_calibrations(state: State, caller: CurrentDevice) -> CalibrationList:
    """This phone's calibrations, including withdrawn ones, the newest first."""
    rows = calibrate_device.own_calibrations(state.database, caller)
    return CalibrationList(items=[CalibrationOut(**_fields(row)) for row in rows])


@router.get("/v1/studies/{study}/calibrations", responses=problem_responses(404, 422))
def get_study_calibrations(study: StudyCode, state: State, _: CurrentStaff) -> StudyCalibrationList:
    """The newest 1,000 calibrations of the study and its phones, including withdrawn ones, the newest first."""
    rows = calibrate_device.study_calibrations(state.database, study)
    return StudyCalibrationList(
        items=[
            StudyCalibrationOut(**_fields(row), participant=participant, device_id=row.device_id)
            for row, participant in rows
        ]
    )


@router.post("/v1/rigs", status_code=201, responses=problem_responses(409, 410, 413, 422))
def post_own_rig(body: RigIn, state: State, caller: CurrentDevice) -> CalibrationOut:
    """Keep this phone's stereo rig, as `tada calibrate --rig --json` prints it: its meals then need no marker."""
    return CalibrationOut(**_fields(calibrate_device.keep_own_rig(state.database, caller, body)))


@router.post(
    "/v1/studies/{study}/rigs", status_code=201, responses=problem_responses(404, 409, 413, 422)
)
def post_study_rig(
    study: StudyCode,
    body: RigIn,
    state: State,
    owner: CurrentStaff,
    model: Annotated[
        Text | None,
        Query(
            min_length=1,
            max_length=200,
            description="Only for the study's phones of this model; default: for all.",
        ),
    ] = None,
) -> CalibrationOut:
    """Keep a stereo rig for the study's phones that have none of their own."""
    return CalibrationOut(
        **_fields(calibrate_device.keep_study_rig(state.database, owner, study, model, body))
    )


@router.post(
    "/v1/calibrations/{calibration_id}/withdrawal", responses=problem_responses(404, 410, 422)
)
def post_calibration_withdrawal(
    calibration_id: Annotated[uuid.UUID, Path(description="The calibration's id.")],
    state: State,
    caller: CurrentCaller,
) -> CalibrationOut:
    """Withdraw a calibration, as the phone itself or an owner of the study. Repeating it changes nothing."""
    return CalibrationOut(
        **_fields(calibrate_device.withdraw_calibration(state.database, caller, calibration_id))
    )


class _CalibrationFields(TypedDict):
    id: uuid.UUID
    kind: Literal["camera", "rig"]
    model: str | None
    marker: str | None
    camera: CameraIn
    rig: RigOut | None
    rms_px: float | None
    photographs: int | None
    created_at: datetime
    withdrawn_at: datetime | None


def _fields(row: CameraCalibration) -> _CalibrationFields:
    return {
        "id": row.id,
        "kind": "camera" if row.rig is None else "rig",
        "model": row.model,
        "marker": row.marker,
        "camera": CameraIn.model_validate(row.camera),
        "rig": RigOut.model_validate(row.rig) if row.rig is not None else None,
        "rms_px": round(row.rms_px, 4) if row.rms_px is not None else None,
        "photographs": row.photographs,
        "created_at": row.created_at,
        "withdrawn_at": row.withdrawn_at,
    }
