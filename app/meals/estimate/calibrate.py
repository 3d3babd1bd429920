"""A camera or a rig from photographs of a board: the child's task, and `tada calibrate`.

Files in -> a camera file or a rig file. Of a phone's photographs few are in memory at a time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

from pydantic import BaseModel

from app.children.child import Arguments, StageListener
from app.core.errors import Failure, InvalidInputError
from app.meals.estimate.estimate_json import failure_to_json
from app.meals.stored.run_answer import Json
from app.vision.board.calibration import calibrate
from app.vision.board.rig_calibration import calibrate_rig
from app.vision.intrinsics import camera_to_json
from app.vision.marker_spec import parse_marker
from app.vision.model import Photo
from app.vision.photograph.photo import read_photo
from app.vision.rig import rig_to_json


class _CalibrateRequest(BaseModel):
    photos: list[Path]
    marker: str
    max_pixels: int


def calibrate_task(arguments: Arguments, _: StageListener) -> Json:
    """A camera from photographs of a board."""
    request = _CalibrateRequest.model_validate(arguments)
    photos = _PhotosOnDisk(request.photos, request.max_pixels)
    try:
        fit = calibrate(photos, parse_marker(request.marker))
    except _UnreadablePhotoError as error:
        return {"failure": failure_to_json(error.failure), "photo": error.index}
    if isinstance(fit, Failure):
        return {"failure": failure_to_json(fit), "photo": None}
    return {
        "failure": None,
        "camera": camera_to_json(fit.camera),
        "rms_px": fit.rms_px,
        "reach": fit.reach,
        "model": photos[0].model,
        "used": list(fit.used),
        "left_out": [
            {"photo": rejected.index, **failure_to_json(rejected.failure)}
            for rejected in fit.rejected
        ],
    }


class _UnreadablePhotoError(Exception):
    """index: of the photograph, from 0."""

    def __init__(self, index: int, failure: Failure) -> None:
        super().__init__(failure.message)
        self.index = index
        self.failure = failure


class _PhotosOnDisk(Sequence[Photo]):
    """Photographs that are decoded when asked for; the first and the last asked for are held, the others not."""

    def __init__(self, paths: Sequence[Path], max_pixels: int) -> None:
        self._paths = paths
        self._max_pixels = max_pixels
        self._held: dict[int, Photo] = {}

    def __len__(self) -> int:
        return len(self._paths)

    @overload
    def __getitem__(self, index: int) -> Photo: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Photo]: ...

    def __getitem__(self, index: int | slice) -> Photo | Sequence[Photo]:
        if isinstance(index, slice):
            return _PhotosOnDisk(self._paths[index], self._max_pixels)
        path = self._paths[index]
        if index not in self._held:
            photo = read_photo(path.read_bytes(), max_pixels=self._max_pixels)
            if isinstance(photo, Failure):
                raise _UnreadablePhotoError(index, photo)
            self._held = {place: held for place, held in self._held.items() if place == 0} | {
                index: photo
            }
        return self._held[index]


PhotoReader = Callable[[Path], Photo]


@dataclass(frozen=True, slots=True)
class CalibratedFiles:
    """document: what the file holds.

    left_out: names of photographs or pairs that were not used, with reasons.
    """

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
        document,
        tuple((str(photos[rejected.index]), rejected.failure) for rejected in calibration.rejected),
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
        document,
        tuple((names[rejected.index], rejected.failure) for rejected in calibration.rejected),
    )
