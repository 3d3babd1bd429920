"""From disparity to points: depth by tie points on the checkerboard, back-projection, the table frame.

Disparity on the row-aligned pair (px) -> depth Z = p + q / disparity (paper, eq. 14) -> points (mm), z up.
"""

from dataclasses import dataclass

import numpy as np

from app.vision.board.pose import bent_points
from app.vision.board.print_layout import common_points
from app.vision.geometry.topview import usable_points
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair, to_rectified_px
from app.vision.views.relative_pose import RefinedViews


@dataclass(frozen=True, slots=True)
class DepthModel:
    """Z = p + q / disparity (eq. 14). p_mm: mm; 0 for ideal views. q_mm_px: mm px; f B for ideal views (eq. 11, 13)."""

    p_mm: float
    q_mm_px: float

    def depth_mm(self, disparity_px: Float32Array) -> Float32Array:
        """Depth along the rectified optical axis, mm; NaN where the disparity is NaN or <= 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.float32(self.p_mm) + np.float32(self.q_mm_px) / disparity_px
            return np.where(disparity_px > 0, depth, np.float32(np.nan))


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """The rectified pair with its points.

    points_table: (H, W, 3) mm, in the views' table frame.
    is_ignored: (H, W) the marker, and what one view misses.
    depths: the photographs' depth maps on the pair's grid, in its scale.
    flags: of every item.
    """

    rectified: RectifiedPair
    disparity: DisparityMap
    depth: DepthModel
    points_table: Float32Array
    is_ignored: MaskArray
    depths: tuple[DisparityMap, ...] = ()
    flags: tuple[str, ...] = ()

    def table_points(self) -> Float32Array:
        """(n, 3) mm, measured beside the marker; every second pixel each way."""
        points, ignored = self.points_table[::2, ::2], self.is_ignored[::2, ::2]
        return points[usable_points(points, ignored)]


def fit_depth_model(disparity_px: Float64Array, depth_mm: Float64Array) -> DepthModel:
    """Fit p and q by least squares over tie points (eq. 14).

    disparity_px, depth_mm: (n,), n >= 2, of more than one depth.

    Minimises the error in disparity rather than in depth, which is where a corner's noise is: d (Z - p) = q. Raises
    ValueError for fewer than two distinct tie points.
    """
    if len(disparity_px) < 2 or np.ptp(disparity_px) <= 0:
        raise ValueError("Two tie points of different disparity are needed.")
    design = (
        np.column_stack([np.ones_like(disparity_px), 1.0 / disparity_px]) * disparity_px[:, None]
    )
    (p_mm, q_mm_px), *_ = np.linalg.lstsq(design, depth_mm * disparity_px, rcond=None)
    return DepthModel(float(p_mm), float(q_mm_px))


def fit_to_marker(pair: RectifiedPair, views: RefinedViews) -> DepthModel:
    """The depth model with the marker's points as tie points: disparities as seen, depths by the poses."""
    common = common_points(views.first.required_marker, views.second.required_marker)
    first_px = to_rectified_px(pair, views.first, common.first_px)
    second_px = to_rectified_px(pair, views.second, common.second_px)
    corners = common.of(bent_points(views.first.required_marker.spec, views.bend_mm))
    return fit_depth_model(first_px[:, 0] - second_px[:, 0], pair.project(corners)[:, 2])


def ideal_depth(pair: RectifiedPair) -> DepthModel:
    """The depth model of views whose poses are exact: Z = f B / disparity (eq. 11)."""
    return DepthModel(0.0, pair.focal_px * pair.baseline_mm)


def plane_points(
    pair: RectifiedPair, window: tuple[slice, slice] = (slice(None), slice(None))
) -> Float32Array:
    """(H, W, 3) where each pixel's ray meets the marker's plane, table frame, mm; NaN above the horizon.

    window: rows and columns of the grid that (H, W) are of.
    """
    depth_mm = ideal_depth(pair).depth_mm(pair.plane_disparity_px()[window])
    return back_project(pair, depth_mm, (window[0].start or 0, window[1].start or 0))


def back_project(
    pair: RectifiedPair, depth_mm: Float32Array, origin: tuple[int, int] = (0, 0)
) -> Float32Array:
    """(H, W, 3) points in the table frame, mm, from depth (H, W) along the rectified axis (eq. 12-13); NaN kept.

    origin: row and column of the grid at which the depth's first pixel lies.
    """
    rows, columns = (
        np.arange(side) + first for side, first in zip(depth_mm.shape, origin, strict=True)
    )
    u = (columns - pair.centre_px[0]) / pair.focal_px
    v = ((rows - pair.centre_px[1]) / pair.focal_px)[:, None]
    points = np.empty((*depth_mm.shape, 3), np.float32)
    # a ray's part along a table axis is linear in u and v; no (H, W, 3) of float64 is needed
    for axis in range(3):
        along_x, along_y, along_z = pair.rotation[:, axis]
        ray = (along_x * u).astype(np.float32) + (along_y * v + along_z).astype(np.float32)
        np.add(ray * depth_mm, np.float32(pair.first_centre_mm[axis]), out=points[..., axis])
    return points
