"""One photograph over the marker: its camera and pose, and how unsure these leave a volume.

Photograph and observation of the marker -> SingleView; a place on the table -> relative standard deviation of volumes
there by pose and lens. Nothing but the marker's corners tells of either.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.camera import estimate_view
from app.vision.board.pose import (
    CORNER_SD_PX_AT_12MP,
    FOCAL_SPREAD_EXIF,
    FOCAL_SPREAD_UNKNOWN,
    LONG_SIDE_12MP,
    board_points,
    project,
)
from app.vision.intrinsics import Camera
from app.vision.model import EstimateOptions, Float64Array, MarkerObservation, Photo, View

CORNERS_PER_FACT = 4.0  # neighbouring corners share what lens and paper do beyond their models
# of the differences: radians, mm, log of f
STEP = np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2, 1e-4])
CUBE_MM = 60.0
LEAST_SD = 0.006  # as of a pair, and what the sheet's bend does to a single view's heights
DEPTH_SCALE_SD = 0.04  # of a volume by a depth map's scale: phones' sensors are good to one or two per cent of depth


@dataclass(frozen=True, slots=True)
class SingleView:
    """doubts: the view one standard deviation along each axis of the covariance of pose and focal length."""

    first: View
    doubts: tuple[View, ...]


def place_alone(
    photo: Photo, observation: MarkerObservation, options: EstimateOptions
) -> SingleView | Failure:
    """The photograph's view by the marker alone. Failures: see camera.estimate_view."""
    view = estimate_view(photo, observation, options)
    return view if isinstance(view, Failure) else SingleView(view, _doubts(view))


def single_volume_sd(view: SingleView, middle_mm: Float64Array) -> float:
    """Relative, of a volume at (2,) x, y on the table: by how much a cube there would be seen larger or smaller."""
    if not view.doubts:
        return DEPTH_SCALE_SD
    own = _log_seen_volume(view.first, middle_mm)
    changes = [_log_seen_volume(doubt, middle_mm) - own for doubt in view.doubts]
    return float(np.hypot(np.sqrt(np.square(changes).sum()), LEAST_SD))


def _log_seen_volume(view: View, middle_mm: Float64Array) -> float:
    """Return the logarithm of the volume that the silhouette of a cube at (2,) x, y stands for, but for a constant."""
    foot = np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * CUBE_MM + middle_mm
    corners = np.concatenate([np.insert(foot, 2, height, axis=1) for height in (0.0, CUBE_MM)])
    seen = project(view.camera, corners, _pose_vector(view))
    return 1.5 * float(np.log(cv2.contourArea(cv2.convexHull(seen.astype(np.float32)))))


def _pose_vector(view: View) -> Float64Array:
    return np.append(cv2.Rodrigues(view.rotation)[0], view.translation_mm)


def _doubts(view: View) -> tuple[View, ...]:
    marker = view.required_marker
    points = marker.seen_of(board_points(marker.spec))
    start = np.append(_pose_vector(view), 0.0)
    sd_px = CORNER_SD_PX_AT_12MP * max(view.camera.width, view.camera.height) / LONG_SIDE_12MP

    def seen(unknowns: Float64Array) -> Float64Array:
        return project(_zoomed(view.camera, float(unknowns[6])), points, unknowns[:6]).ravel()

    free = 6 if view.camera.source == "given" else 7
    moved = [seen(start + step) - seen(start - step) for step in np.diag(STEP)[:free]]
    jacobian = np.stack(moved) / (2 * STEP[:free, None])
    normal = jacobian @ jacobian.T / (sd_px**2 * CORNERS_PER_FACT)
    if free > 6:
        spread = FOCAL_SPREAD_EXIF if view.camera.source == "exif" else FOCAL_SPREAD_UNKNOWN
        normal[6, 6] += 1.0 / spread**2
    axes = np.linalg.cholesky(np.linalg.inv(normal)).T
    return tuple(_moved(view, start + np.append(axis, np.zeros(7 - free))) for axis in axes)


def _moved(view: View, unknowns: Float64Array) -> View:
    rotation = np.asarray(cv2.Rodrigues(unknowns[:3])[0], np.float64)
    camera = _zoomed(view.camera, float(unknowns[6]))
    return replace(view, camera=camera, rotation=rotation, translation_mm=unknowns[3:6])


def _zoomed(camera: Camera, log_scale: float) -> Camera:
    scale = float(np.exp(log_scale))
    return replace(camera, fx=camera.fx * scale, fy=camera.fy * scale)
