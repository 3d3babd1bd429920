"""How both rectified views see points over the table: pixels, parallax, and how these change with the points.

Points (mm, table frame) -> px of the rectified first view, parallax, px of the second. What small errors of the poses
leave shows as parallax of the table, whose true parallax is known; it is taken along as drift.
"""

from dataclasses import dataclass

import numpy as np

from app.vision.geometry.projective import pixel_gradient
from app.vision.geometry.topview import TableTrend
from app.vision.model import Float32Array, Float64Array
from app.vision.views.rectification import RectifiedPair

SAMPLES = 12  # a side, of the window in which the drift is fitted by a plane


@dataclass(frozen=True, slots=True)
class Sight:
    """drift: (e, ex, ey), the parallax e + ex x + ey y that the table itself shows around the food, px."""

    pair: RectifiedPair
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def cameras_mm(self) -> tuple[Float64Array, Float64Array]:
        """(3,) centres of the first and the second camera."""
        pair = self.pair
        return pair.first_centre_mm, pair.first_centre_mm + pair.baseline_mm * pair.rotation[0]

    def project(self, points_table: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(n, 3) mm -> (n, 2) px of the first view and (n,) parallax as the photographs show it, px."""
        pair, (a, b, c) = self.pair, self.pair.plane_px
        seen = pair.project(points_table)
        pixels = seen[:, :2]
        disparity = pair.focal_px * pair.baseline_mm / seen[:, 2]
        parallax = (disparity - a * pixels[:, 0] - b * pixels[:, 1] - c) / (1 - a)
        return pixels, parallax + self.drift_px(pixels)

    def drift_px(self, pixels: Float64Array) -> Float64Array:
        """(n,) parallax that the table shows at (n, 2) px."""
        return np.asarray(self.drift[0] + pixels @ np.array(self.drift[1:]), np.float64)

    def depth_mm(self, pixels: Float64Array, parallax_px: Float64Array) -> Float64Array:
        """(n,) depth along the rectified axis of (n, 2) px of the first view with this parallax."""
        pair, (a, b, c) = self.pair, self.pair.plane_px
        disparity = (
            a * pixels[:, 0]
            + b * pixels[:, 1]
            + c
            + (1 - a) * (parallax_px - self.drift_px(pixels))
        )
        return pair.focal_px * pair.baseline_mm / np.maximum(disparity, 1e-6)

    def points(self, pixels: Float64Array, parallax_px: Float64Array) -> Float64Array:
        """(n, 3) mm, table frame: the inverse of project."""
        depth = self.depth_mm(pixels, parallax_px)[:, None]
        return (self.pair.rays(pixels) * depth) @ self.pair.rotation + self.pair.first_centre_mm

    def parallax_per_mm(self, depth_mm: Float64Array) -> Float64Array:
        """(n,) derivative of the parallax by depth, px/mm, negative."""
        pair = self.pair
        return -pair.focal_px * pair.baseline_mm / depth_mm**2 / (1 - pair.plane_px[0])

    def pixel_gradient(self, points_table: Float64Array, view: int) -> Float64Array:
        """(n, 2, 3) derivative of the pixel in the first (0) or second (1) view by the point, px/mm."""
        pair = self.pair
        in_camera = (points_table - pair.first_centre_mm) @ pair.rotation.T
        out = pixel_gradient(in_camera, pair.rotation, pair.focal_px)
        if view == 1:
            a, b, _ = pair.plane_px
            depth = in_camera[:, 2]
            towards = (-pair.focal_px * pair.baseline_mm / depth**2)[:, None] * pair.rotation[2]
            out[:, 0] -= (towards - a * out[:, 0] - b * out[:, 1]) / (1 - a)
        return out

    def in_view(self, pixels: Float64Array, parallax_px: Float64Array, view: int) -> Float64Array:
        """(n, 2) px in that view."""
        if view == 0:
            return pixels
        return np.column_stack([pixels[:, 0] - parallax_px, pixels[:, 1]])


def sight_of(
    pair: RectifiedPair, trend: TableTrend, plane_xy_mm: Float32Array, window: tuple[slice, slice]
) -> Sight:
    """The pair with the drift around a food. window: rows, columns of it. plane_xy_mm: there, see plane_points."""
    rows, columns = (
        np.linspace(each.start, each.stop - 1, SAMPLES).astype(np.int64) for each in window
    )
    y, x = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    height = trend.height_mm(plane_xy_mm[y - window[0].start, x - window[1].start])
    camera_height = pair.first_centre_mm[2]
    a, b, c = pair.plane_px
    parallax = (a * x + b * y + c) * (camera_height / (camera_height - height) - 1) / (1 - a)
    is_measured = np.isfinite(parallax)
    if np.count_nonzero(is_measured) < 3:
        return Sight(pair)
    design = np.column_stack([np.ones(len(x)), x, y])[is_measured]
    e, ex, ey = np.linalg.lstsq(design, parallax[is_measured], rcond=None)[0]
    return Sight(pair, (float(e), float(ex), float(ey)))
