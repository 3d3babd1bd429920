"""How unsure a volume is by what is unsure of the poses and lenses.

Refined views with their doubts and where the foods lie -> relative standard deviation of volumes there. Each doubt is
one pair of views that the photographs allow nearly as well; it would see a cube at the foods larger or smaller.
"""

import cv2
import numpy as np

from app.vision.features import triangulate
from app.vision.model import Float32Array, Float64Array, View
from app.vision.pose import project
from app.vision.relative_pose import RefinedViews

CUBE_MM = 60.0
LEAST_SD = 0.003  # what a flat board and two radial terms leave out of a sheet and a lens


def volume_sd(views: RefinedViews, points_table: Float32Array) -> float:
    """Relative, shared by all foods of the pair. points_table: (n, 3) of the foods, mm, NaN where unmeasured."""
    known = points_table[np.isfinite(points_table[:, 2]), :2]
    middle_mm = np.median(known, axis=0) if len(known) else np.zeros(2)
    corners = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [0.0, 1.0], indexing="ij"), axis=-1).reshape(-1, 3)
    cube = corners * CUBE_MM + [*middle_mm, 0.0]
    first_px, second_px = _seen_by(views.first, cube), _seen_by(views.second, cube)
    base = _log_volume(views.first, views.second, first_px, second_px)
    changes = [_log_volume(*pair, first_px, second_px) - base for pair in views.doubts]
    return float(np.hypot(np.sqrt(np.square(changes).sum()), LEAST_SD))


def _seen_by(view: View, points_table: Float64Array) -> Float64Array:
    """(n, 2) px of (n, 3) mm."""
    return project(view.camera, points_table, np.append(cv2.Rodrigues(view.rotation)[0], view.translation_mm))


def _log_volume(first: View, second: View, first_px: Float64Array, second_px: Float64Array) -> float:
    """Logarithm of the volume that these views give what is seen at the pixels, up to a constant."""
    points = triangulate(first, second, first_px, second_px).reshape(2, 2, 2, 3)
    edges = np.stack([np.diff(points, axis=axis).reshape(-1, 3).mean(axis=0) for axis in range(3)])
    return float(np.log(abs(np.linalg.det(edges))))
