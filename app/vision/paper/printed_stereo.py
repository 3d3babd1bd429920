"""Stereo as the paper prints it: F from one draw, H = G R T, normalised cross correlation, Z = p + q / disparity.

Views, matches and the foods' masks -> points in the depth frame (mm): x along the baseline, z along the depth axis of
the rectified left camera, which is at its origin. Which readings of the paper were chosen: docs/volume.md, "The paper's
method as printed".
"""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from app.core.errors import Failure
from app.vision.board.pose import bent_points
from app.vision.board.print_layout import common_points
from app.vision.geometry.pictures import grey_of
from app.vision.geometry.projective import homogeneous, map_points, rotation_along
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray
from app.vision.paper.fundamental import (
    DRAWN_MATCHES,
    fundamental_from_points,
    rectify_by_fundamental,
)
from app.vision.views.disparity import MIN_CORRELATION
from app.vision.views.features import Matches, too_few_matches, undistort_to_pinhole
from app.vision.views.reconstruction import DepthModel, fit_depth_model
from app.vision.views.rectification import RectifiedPair, warp_view
from app.vision.views.relative_pose import RefinedViews

# of the correlation: larger than a smoothed search's, since nothing else steadies it
WINDOW_PX = 15
MARGIN_PX = 16  # around the foods, so that windows at their outline are whole
RANGE_QUANTILES = (0.02, 0.98)  # of the matches' disparities; single wrong ones lie outside
MAX_RANGE_PX = 256  # of the search
# of disparity from one pixel to the next: a larger one is a wrong match or another surface
SURFACE_STEP_PX = 1.0
MIN_DEVIATION = 0.5  # grey levels in a window; below, there is nothing to correlate


@dataclass(frozen=True, slots=True)
class PrintedStereo:
    """What one draw of matches made of a pair.

    points_mm: (H, W, 3) float32 in the depth frame, NaN where unmatched. masks: (H, W) each food.
    surfaces: (H, W) the largest part of each that was matched without a step. depth: p and q.
    depth_covariance: (2, 2) of p and q. drawn: (16,) indices of the matches. table_to_depth_rotation: (3, 3).
    centre_mm: (3,) first camera, table frame. disparity_px: (H, W) as eq. 14 takes it.
    """

    points_mm: Float32Array
    disparity_px: Float32Array
    masks: tuple[MaskArray, ...]
    surfaces: tuple[MaskArray, ...]
    depth: DepthModel
    depth_covariance: Float64Array
    drawn: NDArray[np.int64]
    table_to_depth_rotation: Float64Array
    centre_mm: Float64Array

    def to_table(self, points_mm: Float64Array) -> Float64Array:
        """(n, 3) mm, depth frame -> (n, 3) mm, table frame."""
        return points_mm @ self.table_to_depth_rotation + self.centre_mm


def reconstruct_as_printed(
    views: RefinedViews,
    matches: Matches,
    pair: RectifiedPair,
    masks: list[MaskArray],
    rng: np.random.Generator,
) -> PrintedStereo | Failure:
    """Points of the foods. masks: (H, W) on the grid of `pair`, which serves for nothing else.

    Failures "too_few_matches" (fewer than 16 on board and food) and "draw_unusable": the draw's F does not rectify the
    photographs, or the marker's disparities do not fall with depth.
    """
    first, second = views.first, views.second
    x, x_second = (
        undistort_to_pinhole(first, matches.first_px),
        undistort_to_pinhole(second, matches.second_px),
    )
    candidates = np.flatnonzero(matches.is_board | matches.is_food)  # section IV.A
    if len(candidates) < DRAWN_MATCHES:
        return too_few_matches(len(candidates))
    drawn = rng.choice(candidates, DRAWN_MATCHES, replace=False)
    sides = _rectify(views, x[drawn], x_second[drawn])
    if isinstance(sides, Failure):
        return sides
    places_px = undistort_to_pinhole(
        first, pair.first_map_px[np.any(masks, axis=0)].astype(np.float64)
    )
    if not sides[0].is_ahead(places_px) or not sides[1].is_ahead(x_second[drawn]):
        return _unusable("it turns the photograph inside out")
    depth = _fit_depth(views, sides)
    if depth is None:
        return _unusable("the disparities of the marker do not fall with its depth")
    model, covariance, sign = depth

    frame, grid = _frame(map_points(sides[0].homography, places_px), masks)
    matched_px = map_points(sides[0].homography, x[candidates])[:, 0]
    matched_px -= map_points(sides[1].homography, x_second[candidates])[:, 0]
    measured_px = _match_foods(views, sides, frame, grid, _search_range(matched_px * frame[0, 0]))

    columns, rows = np.meshgrid(
        np.arange(grid[0], dtype=np.float64), np.arange(grid[1], dtype=np.float64)
    )
    in_first = np.column_stack([columns.ravel(), rows.ravel()])
    in_second: Float64Array = in_first - np.column_stack(
        [measured_px.ravel(), np.zeros(measured_px.size)]
    )
    to_pixels: Float64Array = np.asarray(np.linalg.inv(frame), np.float64)
    rectified_px, second_px = map_points(to_pixels, in_first), map_points(to_pixels, in_second)
    disparity_px: Float64Array = sign * (
        sides[0].metric_x(rectified_px) - sides[1].metric_x(second_px)
    )
    rays = sides[0].rays(rectified_px)
    points = rays * model.depth_mm(disparity_px.astype(np.float32))[:, None]  # eq. 12
    carried = [_carried(mask, pair, rays @ first.rotation, measured_px.shape) for mask in masks]
    turn = sides[0].depth_frame()
    return PrintedStereo(
        points_mm=(points @ turn.T).reshape(*measured_px.shape, 3).astype(np.float32),
        disparity_px=disparity_px.reshape(measured_px.shape).astype(np.float32),
        masks=tuple(carried),
        surfaces=tuple(_largest_surface(measured_px, mask) for mask in carried),
        depth=model,
        depth_covariance=covariance,
        drawn=drawn,
        table_to_depth_rotation=turn @ first.rotation,
        centre_mm=first.centre_mm,
    )


@dataclass(frozen=True, slots=True)
class _Side:
    """One camera and its rectifying homography, of that sign by which what is ahead of the camera stays ahead.

    inverse_camera: (3, 3) K^-1. axis: (3,) third row of H K: the depth axis, camera frame, as long as H has it.
    baseline: (3,) unit, the direction that H sends to (1, 0, 0). focal_px: the first camera's, on both sides.
    """

    homography: Float64Array
    inverse_camera: Float64Array
    axis: Float64Array
    baseline: Float64Array
    focal_px: float

    @classmethod
    def of(cls, homography: Float64Array, camera: Float64Array, focal_px: float) -> "_Side":
        rows = homography @ camera
        if rows[2, 2] < 0:
            homography, rows = -homography, -rows
        baseline = np.cross(rows[1], rows[2])
        baseline *= np.sign(rows[0] @ baseline) / np.linalg.norm(baseline)
        return cls(
            homography, np.asarray(np.linalg.inv(camera), np.float64), rows[2], baseline, focal_px
        )

    def is_ahead(self, pixels: Float64Array) -> bool:
        """Whether H keeps all of (n, 2) px of the pinhole on one side of its horizon."""
        return bool((homogeneous(pixels) @ self.homography[2] > 0).all())

    def turn(self, camera: Float64Array) -> Float64Array:
        """(3, 3) H as it moves rays, K^-1 H K."""
        return self.inverse_camera @ self.homography @ camera

    def rays(self, pixels: Float64Array) -> Float64Array:
        """(n, 2) rectified px -> (n, 3) in the camera's frame, one long along the depth axis."""
        return (
            homogeneous(pixels)
            @ (self.inverse_camera @ np.linalg.inv(self.homography)).T
            * self.length()
        )

    def length(self) -> float:
        return float(np.linalg.norm(self.axis))

    def metric_x(self, pixels: Float64Array) -> Float64Array:
        """(n,) x of rectified px as a camera turned, not warped, to the baseline has it: f X / Z.

        Only there is disparity inversely proportional to depth (eq. 11). The least squares of section IV.B shear H' so
        that disparities vanish in the middle of the scene, where eq. 14 has its pole.
        """
        return self.rays(pixels) @ self.baseline * self.focal_px

    def depth_frame(self) -> Float64Array:
        """(3, 3) camera to depth frame."""
        return rotation_along(self.baseline, self.axis)


def _rectify(
    views: RefinedViews, x: Float64Array, x_second: Float64Array
) -> tuple[_Side, _Side] | Failure:
    """H and H' of F from the drawn matches, (16, 2) px of the pinholes (eq. 4-9). Failure "draw_unusable"."""
    first, second = views.first.camera, views.second.camera
    fundamental = fundamental_from_points(x, x_second)
    if fundamental is None:
        return _unusable("the matches lie in one point")
    homographies = rectify_by_fundamental(fundamental, x, x_second, (first.width, first.height))
    if homographies is None:
        return _unusable("its epipole lies within the photograph")
    return _Side.of(homographies[0], first.matrix, first.fx), _Side.of(
        homographies[1], second.matrix, first.fx
    )


def _unusable(reason: str) -> Failure:
    return Failure(
        "draw_unusable",
        f"The fundamental matrix of one random draw of {DRAWN_MATCHES} matches cannot be used: {reason}.",
        "This is a weakness of the method paper-strict: measure by the default method.",
    )


def _fit_depth(
    views: RefinedViews, sides: tuple[_Side, _Side]
) -> tuple[DepthModel, Float64Array, float] | None:
    """Fit p and q to the marker's points (eq. 14); with them, their covariance and the sign of disparities.

    None unless all depths of tie points are positive and fall as disparity grows.
    """
    common = common_points(views.first.required_marker, views.second.required_marker)
    x, x_second = (
        side.metric_x(map_points(side.homography, undistort_to_pinhole(view, px)))
        for side, view, px in zip(
            sides, (views.first, views.second), (common.first_px, common.second_px), strict=True
        )
    )
    corners = common.of(bent_points(views.first.required_marker.spec, views.bend_mm))
    in_camera = corners @ views.first.rotation.T + views.first.translation_mm
    depth_mm = in_camera @ sides[0].axis / sides[0].length()
    sign = float(np.sign(np.median(x - x_second)))
    disparity = sign * (x - x_second)  # |x - x'| (eq. 11)
    if not (disparity > 0).all() or np.ptp(disparity) <= 0:
        return None
    model = fit_depth_model(disparity, depth_mm)
    if model.q_mm_px <= 0:
        return None
    design = np.column_stack([disparity, np.ones_like(disparity)])  # d Z = p d + q
    residual = disparity * (depth_mm - model.p_mm) - model.q_mm_px
    variance = float(residual @ residual) / max(len(residual) - 2, 1)
    return model, np.asarray(variance * np.linalg.inv(design.T @ design), np.float64), sign


def _frame(places_px: Float64Array, masks: list[MaskArray]) -> tuple[Float64Array, tuple[int, int]]:
    """(3, 3) from rectified px to a grid around the foods, as fine as the masks' own, and its (width, height)."""
    rows, columns = np.nonzero(np.any(masks, axis=0))
    low, high = places_px.min(axis=0), places_px.max(axis=0)
    scale = max(1.0, float(np.ptp(rows)), float(np.ptp(columns))) / max(
        float((high - low).max()), 1e-9
    )
    width, height = (int(np.ceil(side * scale)) + 2 * MARGIN_PX for side in high - low)
    shift = MARGIN_PX - low * scale
    return np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]]), (
        width,
        height,
    )


def _search_range(disparity_px: Float64Array) -> tuple[int, int]:
    """The matches' disparities on the grid, (n,), and as much again to either side."""
    low, high = np.quantile(disparity_px, RANGE_QUANTILES)
    half = 1.5 * min(float(high - low) + MARGIN_PX, MAX_RANGE_PX / 3)
    return int(np.floor((low + high) / 2 - half)), int(np.ceil((low + high) / 2 + half))


def _match_foods(
    views: RefinedViews,
    sides: tuple[_Side, _Side],
    frame: Float64Array,
    grid: tuple[int, int],
    search_px: tuple[int, int],
) -> Float32Array:
    """(H, W) disparity on the grid around the foods; both photographs are resampled to it (section IV.B)."""
    low, high = search_px
    wider = np.array([[1.0, 0.0, float(high)], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ frame
    pictures = []
    for view, side, to_grid, width in (
        (views.first, sides[0], frame, grid[0]),
        (views.second, sides[1], wider, grid[0] + high - low),
    ):
        camera = view.camera.matrix
        picture, _ = warp_view(
            view, to_grid @ camera, side.turn(camera) @ view.rotation, (width, grid[1])
        )
        pictures.append(picture)
    return match_by_correlation(pictures[0], pictures[1], low, high)


def match_by_correlation(
    first_bgr: ImageArray, second_bgr: ImageArray, low: int, high: int
) -> Float32Array:
    """(H, W) disparity x - x' of the greatest normalised cross correlation (section IV.D), px; NaN where unmatched.

    first_bgr: (H, W, 3). second_bgr: (H, W + high - low, 3), whose column c is x' = c - high. A parabola through the
    neighbours of the greatest value settles the fraction; a greatest value at either end of the search is no match.
    """
    first, second = (grey_of(picture).astype(np.float32) for picture in (first_bgr, second_bgr))
    mean, deviation = _moments(first)
    second_mean, second_deviation = _moments(second)
    height, width = first.shape
    best = np.full((height, width), -1.0, np.float32)
    before, after, at = np.zeros_like(best), np.zeros_like(best), np.full_like(best, low)
    previous = np.full_like(best, -1.0)
    for disparity in range(low, high + 1):
        there = slice(high - disparity, high - disparity + width)
        covariance = _box(first * second[:, there]) - mean * second_mean[:, there]
        scale = deviation * second_deviation[:, there]
        score = np.where(
            scale > MIN_DEVIATION**2,
            covariance / np.maximum(scale, np.float32(1e-6)),
            np.float32(-1.0),
        )
        after = np.where(at == disparity - 1, score, after)
        is_better = score > best
        best, before = np.where(is_better, score, best), np.where(is_better, previous, before)
        at = np.where(is_better, np.float32(disparity), at)
        previous = score
    curvature = np.maximum(2 * best - before - after, np.float32(1e-6))
    fraction = np.clip(0.5 * (after - before) / curvature, -0.5, 0.5)
    is_matched = (best > MIN_CORRELATION) & (at > low) & (at < high)
    return np.where(is_matched, at + fraction, np.float32(np.nan)).astype(np.float32)


def _moments(grey: Float32Array) -> tuple[Float32Array, Float32Array]:
    """(H, W) mean and standard deviation in each window."""
    mean = _box(grey)
    return mean, np.sqrt(np.maximum(_box(grey * grey) - mean * mean, 0.0))


def _box(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.boxFilter(image, cv2.CV_32F, (WINDOW_PX, WINDOW_PX)), np.float32)


def _largest_surface(disparity_px: Float32Array, mask: MaskArray) -> MaskArray:
    """(H, W) the largest part of a mask over which disparity has no step: no wrong matches, nothing behind."""
    is_measured = mask & np.isfinite(disparity_px)
    index = np.arange(mask.size).reshape(mask.shape)
    ends = []
    for here, beside in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        joins = is_measured[here] & is_measured[beside]
        joins[joins] = (
            np.abs(disparity_px[here][joins] - disparity_px[beside][joins]) < SURFACE_STEP_PX
        )
        ends.append(np.stack([index[here][joins], index[beside][joins]]))
    start, end = np.concatenate(ends, axis=1)
    graph = scipy.sparse.coo_array(
        (np.ones(len(start), np.int8), (start, end)), shape=(mask.size, mask.size)
    )
    label = scipy.sparse.csgraph.connected_components(graph, directed=False)[1].reshape(mask.shape)
    if not is_measured.any():
        return is_measured
    return np.asarray(is_measured & (label == np.bincount(label[is_measured]).argmax()), np.bool_)


def _carried(
    mask: MaskArray, pair: RectifiedPair, rays_table: Float64Array, shape: tuple[int, ...]
) -> MaskArray:
    """A mask of the grid of `pair` on the printed grid of this shape, whose rays (n, 3) are known, table frame."""
    rays = rays_table @ pair.rotation.T
    pixels = pair.focal_px * rays[:, :2] / rays[:, 2:] + pair.centre_px
    maps = pixels.reshape(*shape[:2], 2).astype(np.float32)
    return cv2.remap(mask.astype(np.uint8), maps[..., 0], maps[..., 1], cv2.INTER_NEAREST) > 0
