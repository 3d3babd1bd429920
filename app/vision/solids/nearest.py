"""The nearest of some points in a picture, by OpenCV's exact single k-d tree, which is built in microseconds."""

import cv2
import numpy as np

from app.vision.geometry.mesh import IntArray
from app.vision.model import Float32Array, Float64Array

KDTREE_SINGLE, LEAF_POINTS = 4, 10  # of cv::flann::KDTreeSingleIndexParams


class Nearest:
    """Finds the nearest of (n, 2) points, px; n > 0. In single precision: distances are right to 1e-3 px."""

    def __init__(self, points_px: Float64Array) -> None:
        self._origin_px = points_px[0].copy()
        self._points_px = self._relative(points_px)  # the tree may look at them
        params: dict[str, bool | int | float | str] = {
            "algorithm": KDTREE_SINGLE,
            "leaf_max_size": LEAF_POINTS,
        }
        self._index = cv2.flann.Index(self._points_px, params)

    def query(self, points_px: Float64Array) -> tuple[Float64Array, IntArray]:
        """Return how far (m, 2) points are from the nearest, (m,) px, and which that is, (m,)."""
        index, squared = self._index.knnSearch(self._relative(points_px), 1, params={})
        return np.sqrt(squared[:, 0], dtype=np.float64), index[:, 0].astype(np.int64)

    def _relative(self, points_px: Float64Array) -> Float32Array:
        return np.asarray(points_px - self._origin_px, np.float32)
