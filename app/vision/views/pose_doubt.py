"""How unsure a volume is by what is unsure of the poses and lenses.

Refined views with their doubts and where the foods lie -> relative standard deviation of volumes there. Each doubt is
one pair of views that the photographs allow nearly as well; it would see a cube at the foods larger or smaller.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.board.pose import project
from app.vision.model import Float32Array, Float64Array, View
from app.vision.views.features import triangulate
from app.vision.views.focal_doubt import FocalDoubt
from app.vision.views.relative_pose import RefinedViews

CUBE_MM = 60.0
LEAST_SD = 0.003  # what a flat board and two radial terms leave out of a sheet and a lens


@dataclass(frozen=True, slots=True)
class VolumeDoubt:
    """Relative sd of a volume by all that poses and lenses leave open, and the part of an unknown focal length."""

    sd: float
    focal_sd: float


def volume_doubt(
    views: RefinedViews, points_table: Float32Array, focal: FocalDoubt | None = None
) -> VolumeDoubt:
    """Shared by all foods of the pair. points_table: (n, 3) of the foods, mm, NaN where unmeasured."""
    measured_xy = points_table[np.isfinite(points_table[:, 2]), :2]
    middle_mm = np.median(measured_xy, axis=0) if len(measured_xy) else np.zeros(2)
    corners = np.stack(
        np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [0.0, 1.0], indexing="ij"), axis=-1
    ).reshape(-1, 3)
    cube = corners * CUBE_MM + [*middle_mm, 0.0]
    changes = _changes((views.first, views.second), views.doubts, cube)
    focal_sd = (
        float(abs(_changes(focal.own, (focal.moved,), cube)[0])) if focal is not None else 0.0
    )
    # The covariance holds the focal length as well, but linearised and by matches whose errors may be alike.
    sd = max(float(np.sqrt(np.square(changes).sum())), focal_sd)
    return VolumeDoubt(float(np.hypot(sd, LEAST_SD)), focal_sd)


def _changes(
    base: tuple[View, View], others: Sequence[tuple[View, View]], cube: Float64Array
) -> list[float]:
    """By how much the logarithm of a cube's volume changes where it is seen by other views. cube: (8, 3) mm."""
    seen = _seen_by(base[0], cube), _seen_by(base[1], cube)
    volume = _log_volume(*base, *seen)
    return [_log_volume(*pair, *seen) - volume for pair in others]


def _seen_by(view: View, points_table: Float64Array) -> Float64Array:
    """(n, 2) px of (n, 3) mm."""
    return project(
        view.camera, points_table, np.append(cv2.Rodrigues(view.rotation)[0], view.translation_mm)
    )


def _log_volume(
    first: View, second: View, first_px: Float64Array, second_px: Float64Array
) -> float:
    """Logarithm of the volume that these views give what is seen at the pixels, up to a constant."""
    points = triangulate(first, second, first_px, second_px).reshape(2, 2, 2, 3)
    edges = np.stack([np.diff(points, axis=axis).reshape(-1, 3).mean(axis=0) for axis in range(3)])
    return float(np.log(abs(np.linalg.det(edges))))
