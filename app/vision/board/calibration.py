"""A camera's intrinsics from photographs of a printed board, by Zhang's method (2000) as OpenCV has it.

Photographs and the announced board in -> Camera (paper, eq. 10, without skew; distortion k1 k2 p1 p2 k3), its
reprojection error, and which photographs were used. Boards are taken as flat: glue them to something for this.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.camera import camera_from_exif
from app.vision.board.marker import find_marker
from app.vision.board.pose import board_points, solve_pose
from app.vision.intrinsics import TOLERATED_RMS_PX, Camera
from app.vision.marker_spec import MarkerSpec
from app.vision.model import Float64Array, MarkerObservation, Photo

MIN_VIEWS = 3  # two planes fix five intrinsics in theory, a third makes them bear noise
# between the steepest different views; parallel planes leave the focal length open
MIN_TILT_SPREAD_DEG = 10.0
MAX_VIEW_RMS_FACTOR = 3.0  # of the median view's; beyond, a view's board was bent or moved
CALIBRATE_ADVICE = (
    "Photograph the whole board ten times or so: from different sides, tilted by 30 to 45 degrees, near the middle"
    " and near the corners of the picture."
)


@dataclass(frozen=True, slots=True)
class RejectedPhoto:
    """A photograph that was left out: its index in the given order, and why."""

    index: int
    failure: Failure


@dataclass(frozen=True, slots=True)
class Calibration:
    """The camera, the rms distance of reprojected corners in px, and the indices of the photographs used.

    reach: how far from the middle corners were seen, in half diagonals of the picture; beyond, distortion is a guess.
    """

    camera: Camera
    rms_px: float
    reach: float
    used: tuple[int, ...]
    rejected: tuple[RejectedPhoto, ...]


def calibrate(photos: Sequence[Photo], spec: MarkerSpec) -> Calibration | Failure:
    """The camera that took these photographs of one board.

    Failures: calibration_views_insufficient (too few boards found, all at one slant, or no photographs of one size).
    """
    observations: dict[int, MarkerObservation] = {}
    rejected: list[RejectedPhoto] = []
    for index, photo in enumerate(photos):
        seen = find_marker(photo, spec)
        if isinstance(seen, Failure):
            rejected.append(RejectedPhoto(index, seen))
        elif photo.pixels_bgr.shape != photos[0].pixels_bgr.shape:
            rejected.append(RejectedPhoto(index, _other_size(photos[0], photo)))
        else:
            observations[index] = seen
    if len(observations) < MIN_VIEWS:
        return _insufficient(
            f"the board was found in {len(observations)} of {len(photos)} photographs of one size",
            rejected,
        )
    spread = _tilt_spread_deg(camera_from_exif(photos[0]), list(observations.values()))
    if spread < MIN_TILT_SPREAD_DEG:
        return _insufficient(
            f"all views see the board from almost one direction ({spread:.0f} degrees apart)",
            rejected,
        )
    size = (photos[0].pixels_bgr.shape[1], photos[0].pixels_bgr.shape[0])
    camera, rms_px, view_rms_px = _fit_intrinsics(list(observations.values()), size)
    limit = max(TOLERATED_RMS_PX, MAX_VIEW_RMS_FACTOR * float(np.median(view_rms_px)))
    poor = [index for index, rms in zip(observations, view_rms_px, strict=True) if rms > limit]
    if poor and len(observations) - len(poor) >= MIN_VIEWS:
        for index in poor:
            observations.pop(index)
            message = f"The board's corners are more than {limit:.1f} px off the others' camera."
            rejected.append(
                RejectedPhoto(
                    index,
                    Failure("calibration_view_poor", message, "Glue the board to a flat plate."),
                )
            )
        camera, rms_px, _ = _fit_intrinsics(list(observations.values()), size)
    reach = _reach(camera, list(observations.values()))
    return Calibration(
        camera,
        rms_px,
        reach,
        tuple(observations),
        tuple(sorted(rejected, key=lambda photo: photo.index)),
    )


def flat_points(spec: MarkerSpec) -> Float64Array:
    """(n, 3) mm, the print's points at z = 0, as OpenCV's first guess wants them, whatever the board's thickness."""
    return board_points(replace(spec, thick_mm=0.0))


def _fit_intrinsics(
    observations: Sequence[MarkerObservation], size: tuple[int, int]
) -> tuple[Camera, float, Float64Array]:
    """Camera, overall rms and each view's rms, px. size: (width, height)."""
    points = [seen.seen_of(flat_points(seen.spec)).astype(np.float32) for seen in observations]
    corners = [seen.corners_px.astype(np.float32) for seen in observations]
    # OpenCV makes its own first guess where the matrix is zero.
    rms, matrix, distortion, _, _, _, _, view_rms = cv2.calibrateCameraExtended(
        points, corners, size, np.zeros((3, 3)), np.zeros(5)
    )
    return (
        calibrated_camera(size, matrix, distortion),
        float(rms),
        np.ravel(view_rms),
    )


def calibrated_camera(
    size: tuple[int, int], matrix: cv2.typing.MatLike, distortion: cv2.typing.MatLike
) -> Camera:
    """A camera from OpenCV's (3, 3) matrix and distortion k1, k2, p1, p2, k3. size: (width, height), px."""
    k1, k2, p1, p2, k3 = (float(value) for value in np.ravel(distortion)[:5])
    return Camera(
        *size,
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion=(k1, k2, p1, p2, k3),
        source="given",
    )


def _tilt_spread_deg(rough: Camera, observations: Sequence[MarkerObservation]) -> float:
    """The largest angle between the board's normals in the camera frame, degrees; rough: a camera of that sort."""
    poses = (solve_pose(rough, seen) for seen in observations)
    normals = np.array([pose[0][:, 2] for pose in poses if pose is not None]).reshape(-1, 3)
    if len(normals) < MIN_VIEWS:
        return 0.0
    return float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))


def _reach(camera: Camera, observations: Sequence[MarkerObservation]) -> float:
    """The farthest corner's distance from the picture's middle, in half diagonals."""
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    corners = np.concatenate([seen.corners_px for seen in observations])
    return float(np.linalg.norm(corners - middle, axis=1).max() / np.linalg.norm(middle))


def _other_size(first: Photo, other: Photo) -> Failure:
    (rows, columns), (other_rows, other_columns) = (
        first.pixels_bgr.shape[:2],
        other.pixels_bgr.shape[:2],
    )
    return Failure(
        "calibration_size_differs",
        f"This photograph has {other_columns} x {other_rows} px, the first one {columns} x {rows} px.",
        "Hold the phone the same way round in all photographs, and do not zoom.",
    )


def _insufficient(reason: str, rejected: Sequence[RejectedPhoto]) -> Failure:
    reasons = "".join(
        f" Photograph {photo.index + 1}: {photo.failure.message}" for photo in rejected[:3]
    )
    return Failure(
        "calibration_views_insufficient",
        f"The camera cannot be calibrated: {reason}.{reasons}",
        CALIBRATE_ADVICE,
    )
