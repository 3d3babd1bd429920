"""A phone's camera measured from photographs of the board: kept with its error, used for the phone's later meals.

The photographs are not kept. A bad calibration would spoil every later meal, so a doubtful one is refused.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from app.children.api_children import ApiChildren, Whose
from app.children.decoding_cost import is_costly
from app.core.errors import ConflictError, Failure, GoneError, InvalidInputError, NotFoundError
from app.core.settings import Settings
from app.db.session import Database
from app.http.upload import ReceivedFile
from app.people import calibration_queries as calibrations
from app.people import privacy_queries as privacy
from app.people import queries as people
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller, require_study
from app.people.calibration_models import CameraCalibration
from app.people.models import Device, Study
from app.vision.intrinsics import TOLERATED_RMS_PX, camera_from_mapping
from app.vision.marker_spec import parse_marker

MIN_PHOTOGRAPHS, MAX_PHOTOGRAPHS = 3, 30
SECONDS = 90.0  # thirty photographs of 12 megapixels take some twenty
MAX_RMS_PX_AT_12MP = 1.0  # twice what phones and printed boards leave (vision/board/calibration.py); beyond, it bends
LONG_SIDE_12MP = 4000.0
MIN_REACH = 0.5  # half diagonals; a plate beside the marker fills more than the middle quarter of the picture
MAX_OF_DEVICE = 100
BY_PHONE = "device"  # no alias: only the audit log and its participant hold that
LISTED = 1000
GET_ANOTHER = (
    "Photograph the whole board ten times or so: from different sides, tilted by 30 to 45 degrees, near the middle and "
    "near the corners of the picture."
)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A photograph that could not be used; number: from 1, as sent."""

    number: int
    code: str
    message: str


@dataclass(frozen=True, slots=True)
class NewCalibration:
    """What was kept, and what was not used."""

    calibration: CameraCalibration
    left_out: tuple[LeftOut, ...]


def calibrate_device(
    database: Database,
    children: ApiChildren,
    settings: Settings,
    caller: DeviceCaller,
    marker: str | None,
    files: Sequence[ReceivedFile],
) -> NewCalibration:
    """Measure and keep. marker: None: the study's.

    Raises InvalidInputError (what is wrong with the photographs, by its code), ConflictError (`calibrations_too_many`),
    GoneError (left the study meanwhile), UnavailableError (`server_busy`), PhotographError.
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
            "Neither the metadata nor the study says which board is in the photographs: send marker, "
            "such as plain:9x7:11.",
            code="marker_missing",
        )
    parse_marker(board)
    found = children.run(
        "calibrate",
        {"photos": [str(file.path) for file in files], "marker": board, "max_pixels": settings.max_photo_pixels},
        seconds=SECONDS,
        whose=Whose(caller.study_id, caller.device_id),
        is_costly=is_costly([file.path for file in files]),
    )
    left_out = _require_good(found)
    with database.write() as session:
        participant = privacy.join_participant(session, caller.participant_id)
        device = session.get(Device, caller.device_id)
        if participant is None or participant.withdrawn_at is not None or device is None:
            raise GoneError("This participant has left the study.", code="withdrawn")
        _require_room(calibrations.count_of_device(session, caller.device_id))
        row = CameraCalibration(
            id=uuid.uuid4(),
            device_id=caller.device_id,
            model=found["model"] or device.model,
            marker=board,
            camera={key: value for key, value in found["camera"].items() if key != "source"},
            rms_px=found["rms_px"],
            photographs=len(found["used"]),
            author=BY_PHONE,
            created_at=datetime.now(UTC),
        )
        session.add(row)
        audit.note(
            session,
            caller,
            "calibration.create",
            subject=caller.participant_alias,
            calibration=str(row.id),
            rms_px=round(row.rms_px, 3),
        )
    return NewCalibration(row, left_out)


def own_calibrations(database: Database, caller: DeviceCaller) -> list[CameraCalibration]:
    """The phone's, the newest first."""
    with database.read() as session:
        return list(calibrations.of_device(session, caller.device_id, LISTED))


def study_calibrations(database: Database, study_code: str) -> list[tuple[CameraCalibration, str]]:
    """(calibration, participant's code) of a study that the caller was let into, the newest first, at most LISTED."""
    with database.read() as session:
        study = people.find_study(session, study_code)
        if study is None:
            raise NotFoundError(f"There is no study {study_code!r}.")
        return calibrations.of_study(session, study.id, LISTED)


def withdraw_calibration(database: Database, caller: Caller, calibration_id: uuid.UUID) -> CameraCalibration:
    """Take a calibration out of use: the one before it holds again. The same again changes nothing.

    Raises NotFoundError, NotAllowedError.
    """
    with database.write() as session:
        found = calibrations.find(session, calibration_id)
        if found is None:
            raise _not_there()
        calibration, study_id, participant_alias = found
        if isinstance(caller, DeviceCaller) and calibration.device_id != caller.device_id:
            raise _not_there()
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


def _require_good(found: Mapping[str, Any]) -> tuple[LeftOut, ...]:
    """The photographs that were left out. Raises InvalidInputError where the rest is not good enough."""
    if found["failure"] is not None:
        failure = Failure(**found["failure"])
        where = f"Photograph {found['photo'] + 1}: " if found["photo"] is not None else ""
        facts = {} if found["photo"] is None else {"photograph": found["photo"] + 1}
        raise InvalidInputError(f"{where}{failure.message} {failure.advice}".strip(), code=failure.code, **facts)
    left_out = tuple(LeftOut(one["photo"] + 1, one["code"], one["message"]) for one in found["left_out"])
    for one in left_out:
        if one.code == "calibration_size_differs":
            raise InvalidInputError(
                f"Photograph {one.number}: {one.message} Hold the phone the same way round in all, and do not zoom.",
                code="calibration_size_differs",
                photograph=one.number,
            )
    camera = camera_from_mapping(found["camera"])
    limit_px = max(TOLERATED_RMS_PX, MAX_RMS_PX_AT_12MP * max(camera.width, camera.height) / LONG_SIDE_12MP)
    if found["rms_px"] > limit_px:
        raise InvalidInputError(
            f"The board's corners fit no camera better than to {found['rms_px']:.2f} px, {limit_px:.2f} px is the limit"
            f": glue the board to something flat and stiff. {GET_ANOTHER}",
            code="calibration_poor",
            rms_px=round(found["rms_px"], 3),
            limit_px=round(limit_px, 3),
        )
    if found["reach"] < MIN_REACH:
        raise InvalidInputError(
            f"The board was only seen near the middle of the picture. {GET_ANOTHER}", code="calibration_coverage_small"
        )
    return left_out


def _require_room(count: int) -> None:
    if count >= MAX_OF_DEVICE:
        raise ConflictError(
            f"This phone has sent {MAX_OF_DEVICE} calibrations: ask the study before sending more.",
            code="calibrations_too_many",
        )


def _not_there() -> NotFoundError:
    return NotFoundError("There is no such calibration.")
