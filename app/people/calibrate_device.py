"""Measure a phone's camera from photographs of the board, for its later meals; keep rigs; list and withdraw both.

The photographs are not kept. A bad calibration would spoil every later meal, so a doubtful one is
refused. Rigs are calibrated elsewhere (`tada calibrate --rig`) and sent by a phone for itself, or
by staff for a study's phones.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import cast

from pydantic import BaseModel, TypeAdapter

from app.children.api_children import ApiChildren, Whose
from app.core.errors import ConflictError, Failure, InvalidInputError, NotFoundError
from app.core.settings import Settings
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.people import calibration_queries as calibrations
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller, StaffCaller, require_study
from app.people.calibration_schemas import CameraIn, RigIn
from app.people.models import CameraCalibration, CameraDetails, Device, RigDetails, Study
from app.people.participants import require_in_study
from app.people.studies import load_study
from app.vision.intrinsics import TOLERATED_RMS_PX, Camera, camera_from_mapping
from app.vision.marker_spec import parse_marker
from app.vision.rig import rig_from_mapping

MIN_PHOTOGRAPHS, MAX_PHOTOGRAPHS = 3, 30
SECONDS = 90.0  # thirty photographs of 12 megapixels take about twenty
# twice the error of phones and flat boards (vision/board/calibration.py); more: a bent board
MAX_RMS_PX_AT_12MP = 1.0
LONG_SIDE_12MP = 4000.0
# half diagonals; a plate beside the marker fills more than the middle quarter of the picture
MIN_REACH = 0.5
MAX_PER_DEVICE = 100
MAX_STUDY_RIGS = 100  # in use: one per model of phone, and some to spare
# not the participant's alias, which only the audit log and the participant's row hold
AUTHOR_PHONE = "device"
MAX_LISTED = 1000
PHOTOGRAPH_AGAIN = (
    "Photograph the whole board about ten times: from different sides, tilted by 30 to 45 degrees, near the middle and "
    "near the corners of the picture."
)


class RejectedPhotograph(BaseModel):
    """A photograph that was not used. photo: its index."""

    photo: int
    code: str
    message: str


class CalibrationFailure(BaseModel):
    """The child's result if there is no calibration.

    photo: index of the photograph that caused it.
    """

    failure: Failure
    photo: int | None


class CalibrationFit(BaseModel):
    """The child's result.

    reach: how far from the middle corners were seen, in half diagonals of the picture.
    """

    failure: None
    camera: CameraIn
    rms_px: float
    reach: float
    model: str | None
    used: list[int]
    left_out: list[RejectedPhotograph]


CALIBRATION_RESULT: TypeAdapter[CalibrationFailure | CalibrationFit] = TypeAdapter(
    CalibrationFailure | CalibrationFit
)


@dataclass(frozen=True, slots=True)
class NewCalibration:
    """A stored calibration and the photographs that were not used."""

    calibration: CameraCalibration
    rejected: Sequence[RejectedPhotograph]


def calibrate_device(
    database: Database,
    children: ApiChildren,
    settings: Settings,
    caller: DeviceCaller,
    marker: str | None,
    files: Sequence[ReceivedFile],
) -> NewCalibration:
    """Measure the camera and store the calibration. marker: None for the study's.

    Raises InvalidInputError (its code tells what is wrong with the photographs), ConflictError
    (`calibrations_too_many`), GoneError (left the study meanwhile), UnavailableError
    (`server_busy`), PhotographError.
    """
    if not MIN_PHOTOGRAPHS <= len(files) <= MAX_PHOTOGRAPHS:
        raise InvalidInputError(
            f"Send {MIN_PHOTOGRAPHS} to {MAX_PHOTOGRAPHS} photographs of the board, not {len(files)}.",
            code="calibration_count",
        )
    with database.read() as session:
        board = marker or session.get_one(Study, caller.study_id).marker
        _require_room(calibrations.count_of_device(session, caller.device_id))
    if board is None:
        raise InvalidInputError(
            "Neither the metadata nor the study names the board in the photographs: send marker, such as plain:9x7:11.",
            code="marker_missing",
        )
    parse_marker(board)
    whose = Whose(caller.study_id, caller.device_id)
    inspected = children.inspect([file.path for file in files], whose)
    result = children.run(
        "calibrate",
        {
            "photos": [str(file.path) for file in files],
            "marker": board,
            "max_pixels": settings.max_photo_pixels,
        },
        seconds=SECONDS,
        whose=whose,
        is_costly=inspected.is_costly,
    )
    fit = _accepted_fit(CALIBRATION_RESULT.validate_python(result))
    with database.write() as session:
        require_in_study(session, caller.participant_id)
        device = session.get_one(Device, caller.device_id)
        _require_room(calibrations.count_of_device(session, caller.device_id))
        row = CameraCalibration(
            id=uuid.uuid4(),
            device_id=caller.device_id,
            model=fit.model or device.model,
            marker=board,
            camera=cast("CameraDetails", fit.camera.model_dump(mode="json")),
            rms_px=fit.rms_px,
            photographs=len(fit.used),
            author=AUTHOR_PHONE,
            created_at=datetime.now(UTC),
        )
        session.add(row)
        audit.note(
            session,
            caller,
            "calibration.create",
            subject=caller.participant_alias,
            calibration=str(row.id),
            rms_px=round(fit.rms_px, 3),
        )
    return NewCalibration(row, fit.left_out)


def keep_own_rig(database: Database, caller: DeviceCaller, rig: RigIn) -> CameraCalibration:
    """Keep a phone's own rig.

    Raises InvalidInputError (`rig_invalid`, `camera_invalid`), ConflictError
    (`calibrations_too_many`), GoneError.
    """
    row = _rig_row(rig, AUTHOR_PHONE)
    with database.write() as session:
        require_in_study(session, caller.participant_id)
        _require_room(calibrations.count_of_device(session, caller.device_id))
        row.device_id, row.model = caller.device_id, session.get_one(Device, caller.device_id).model
        session.add(row)
        audit.note(
            session,
            caller,
            "calibration.create",
            subject=caller.participant_alias,
            calibration=str(row.id),
            kind="rig",
        )
    return row


def keep_study_rig(
    database: Database, caller: StaffCaller, study_code: str, model: str | None, rig: RigIn
) -> CameraCalibration:
    """Keep a rig for a study's phones of a model, or for all of them.

    Raises NotFoundError, InvalidInputError (`rig_invalid`, `camera_invalid`), ConflictError
    (`rigs_too_many`).
    """
    row = _rig_row(rig, caller.name)
    with database.write() as session:
        row.study_id, row.model = load_study(session, study_code, lock=True).id, model
        if calibrations.count_rigs_of_study(session, row.study_id) >= MAX_STUDY_RIGS:
            raise ConflictError(
                f"The study has {MAX_STUDY_RIGS} rigs in use, the limit: withdraw some first.",
                code="rigs_too_many",
                limit=MAX_STUDY_RIGS,
            )
        session.add(row)
        audit.note(
            session,
            caller,
            "calibration.create",
            study_id=row.study_id,
            calibration=str(row.id),
            kind="rig",
        )
    return row


def rig_details(rig: RigIn) -> RigDetails:
    """Return a request's rig as stored.

    Raises InvalidInputError (`rig_invalid`, `camera_invalid`).
    """
    details = rig.model_dump(mode="json", include={"left", "right", "R", "t_mm"})
    rig_from_mapping(details)
    return cast("RigDetails", details)


def _rig_row(rig: RigIn, author: str) -> CameraCalibration:
    details = rig_details(rig)
    if rig.rms_px is not None:
        _require_small_error(rig.rms_px, rig_from_mapping(details).left)
    return CameraCalibration(
        id=uuid.uuid4(),
        camera=details["left"],
        rig=details,
        rms_px=rig.rms_px,
        photographs=rig.pairs,
        author=author,
        created_at=datetime.now(UTC),
    )


def own_calibrations(database: Database, caller: DeviceCaller) -> Sequence[CameraCalibration]:
    """Return the phone's calibrations, the newest first."""
    with database.read() as session:
        return calibrations.of_device(session, caller.device_id, MAX_LISTED)


def study_calibrations(
    database: Database, study_code: str
) -> list[tuple[CameraCalibration, str | None]]:
    """Return the newest MAX_LISTED (calibration, participant's code) of a study and its phones.

    Raises NotFoundError.
    """
    with database.read() as session:
        return calibrations.of_study(session, load_study(session, study_code).id, MAX_LISTED)


def withdraw_calibration(
    database: Database, caller: Caller, calibration_id: uuid.UUID
) -> CameraCalibration:
    """Withdraw a calibration, so that the phone uses the one before it.

    Repeating it changes nothing.

    Raises NotFoundError, NotAllowedError.
    """
    with database.write() as session:
        row = calibrations.find(session, calibration_id)
        if row is None:
            raise _not_found()
        calibration, study_id, participant_alias = row
        if isinstance(caller, DeviceCaller) and calibration.device_id != caller.device_id:
            raise _not_found()
        require_study(caller, study_id, "calibration")
        if calibration.withdrawn_at is None:
            calibration.withdrawn_at = datetime.now(UTC)
            audit.note(
                session,
                caller,
                "calibration.withdraw",
                study_id=study_id,
                subject=participant_alias,
                calibration=str(calibration.id),
            )
    return calibration


def _accepted_fit(result: CalibrationFailure | CalibrationFit) -> CalibrationFit:
    """Return the fit. Raises InvalidInputError if there is none or it is not good enough."""
    if isinstance(result, CalibrationFailure):
        failure = result.failure
        where = f"Photograph {result.photo + 1}: " if result.photo is not None else ""
        facts = {"photograph": result.photo + 1} if result.photo is not None else {}
        raise InvalidInputError(
            f"{where}{failure.message} {failure.advice}".strip(), code=failure.code, **facts
        )
    for rejected in result.left_out:
        if rejected.code == "calibration_size_differs":
            number = rejected.photo + 1
            raise InvalidInputError(
                f"Photograph {number}: {rejected.message} Hold the phone the same way round in all, and do not zoom.",
                code="calibration_size_differs",
                photograph=number,
            )
    _require_small_error(result.rms_px, camera_from_mapping(result.camera.model_dump()))
    if result.reach < MIN_REACH:
        raise InvalidInputError(
            f"The board was only seen near the middle of the picture. {PHOTOGRAPH_AGAIN}",
            code="calibration_coverage_small",
        )
    return result


def _require_small_error(rms_px: float, camera: Camera) -> None:
    limit_px = max(
        TOLERATED_RMS_PX, MAX_RMS_PX_AT_12MP * max(camera.width, camera.height) / LONG_SIDE_12MP
    )
    if rms_px > limit_px:
        raise InvalidInputError(
            f"The board's corners fit the camera to {rms_px:.2f} px only, {limit_px:.2f} px is the limit: glue "
            f"the board to something flat and stiff. {PHOTOGRAPH_AGAIN}",
            code="calibration_poor",
            rms_px=round(rms_px, 3),
            limit_px=round(limit_px, 3),
        )


def _require_room(count: int) -> None:
    if count >= MAX_PER_DEVICE:
        raise ConflictError(
            f"This phone has sent {MAX_PER_DEVICE} calibrations: ask the study before sending more.",
            code="calibrations_too_many",
        )


def _not_found() -> NotFoundError:
    return NotFoundError("There is no such calibration.")
