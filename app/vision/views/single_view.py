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
from app.vision.geometry.projective import homogeneous
from app.vision.intrinsics import Camera
from app.vision.model import EstimateOptions, Float64Array, MarkerObservation, Photo, View
from app.vision.views.features import undistort_to_rays

CORNERS_PER_FACT = 4.0  # neighbouring corners share what lens and paper do beyond their models
STEP = np.array(
    [1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2, 1e-4]
)  # of the differences: radians, mm, log of f
CUBE_MM = 60.0
LEAST_SD = 0.006  # as of a pair, and what the sheet's bend does to a single view's heights
DEPTH_SCALE_SD = 0.04  # of a volume by a depth map's scale: phones' sensors are good to one or two per cent of depth
MIN_SLANT = 0.05  # horizontal part of a ray, below which it tells no height


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
    pixels = project(view.first.camera, cube_at(middle_mm), _pose_vector(view.first))
    own = _log_volume(view.first, pixels)
    changes = [_log_volume(doubt, pixels) - own for doubt in view.doubts]
    return float(np.hypot(np.sqrt(np.square(changes).sum()), LEAST_SD))


def cube_at(middle_mm: Float64Array) -> Float64Array:
    """Return the corners (8, 3) of a cube at (2,) x, y on the table, its foot first, each in order."""
    corners = np.array(
        [[x, y, z] for z in (0.0, 1.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    ) - [0.5, 0.5, 0.0]
    return np.asarray(corners * CUBE_MM + [*middle_mm, 0.0], np.float64)


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


def _log_volume(view: View, pixels: Float64Array) -> float:
    """Logarithm of the volume that the view gives an upright box seen at (8, 2) px, foot and top, in order."""
    rays = homogeneous(undistort_to_rays(view, pixels)) @ view.rotation
    camera = view.centre_mm
    foot = (camera + rays[:4] * (-camera[2] / rays[:4, 2])[:, None])[:, :2]
    following = np.roll(foot, -1, axis=0)
    area = abs(float((foot[:, 0] * following[:, 1] - foot[:, 1] * following[:, 0]).sum())) / 2
    flat = rays[4:, :2]
    reach = ((foot - camera[:2]) * flat).sum(axis=1) / np.maximum(
        (flat**2).sum(axis=1), MIN_SLANT**2
    )
    height = float(np.mean(camera[2] + reach * rays[4:, 2]))
    return float(np.log(max(area, 1e-6)) + np.log(max(height, 1e-6)))
