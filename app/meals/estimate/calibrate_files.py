"""`tada calibrate`: photographs of a board in, a camera file or a rig file out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.core.errors import Failure, InvalidInputError
from app.meals.estimate.camera_json import camera_to_json, rig_to_json
from app.meals.stored.run_answer import Json
from app.vision.board.calibration import calibrate
from app.vision.board.rig_calibration import calibrate_rig
from app.vision.marker_spec import parse_marker
from app.vision.model import Photo

PhotoReader = Callable[[Path], Photo]


@dataclass(frozen=True, slots=True)
class CalibratedFiles:
    """document: what the file holds. left_out: names of photographs or pairs that were not used, with reasons."""

    document: Json
    left_out: tuple[tuple[str, Failure], ...]


def calibrate_camera_files(
    photos: Sequence[Path], marker: str, read: PhotoReader
) -> CalibratedFiles | Failure:
    """The camera that took the photographs. Raises InvalidInputError (the marker's text)."""
    calibration = calibrate([read(path) for path in photos], parse_marker(marker))
    if isinstance(calibration, Failure):
        return calibration
    document = camera_to_json(calibration.camera) | {
        "rms_px": round(calibration.rms_px, 4),
        "photographs": len(calibration.used),
    }
    return CalibratedFiles(
        document, tuple((str(photos[each.index]), each.failure) for each in calibration.rejected)
    )


def calibrate_rig_files(
    photos: Sequence[Path], marker: str, read: PhotoReader
) -> CalibratedFiles | Failure:
    """The rig whose left camera took the first half of the photographs and whose right one the second, pair by pair.

    Raises InvalidInputError (the marker's text, an odd number of photographs).
    """
    if len(photos) % 2:
        raise InvalidInputError(
            f"{len(photos)} photographs are no pairs: give those of the left camera, then as many of the right one, "
            "in the same order."
        )
    left, right = photos[: len(photos) // 2], photos[len(photos) // 2 :]
    calibration = calibrate_rig(
        [read(path) for path in left], [read(path) for path in right], parse_marker(marker)
    )
    if isinstance(calibration, Failure):
        return calibration
    document = rig_to_json(calibration.rig) | {
        "baseline_mm": round(calibration.rig.baseline_mm, 3),
        "rms_px": round(calibration.rms_px, 4),
        "pairs": len(calibration.used),
    }
    names = [f"{first}, {second}" for first, second in zip(left, right, strict=True)]
    return CalibratedFiles(
        document, tuple((names[each.index], each.failure) for each in calibration.rejected)
    )
