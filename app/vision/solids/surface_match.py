"""Parallax measured along a form's own surface: windows follow it, stop at its outline, and tell how sure they are.

A form's vertices and both rectified views -> the parallax that the photographs show there, with its spread. A window
that follows the surface needs no slant of its own and never mixes the food with what lies behind it, so that it reads
right up to the rim, where volume is (surface-induced correlation).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.masks import window_around
from app.vision.geometry.mesh import IntArray, Topology, faces_towards
from app.vision.geometry.pictures import blurred
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.tuning import TUNING
from app.vision.views.disparity import DisparityMap
from app.vision.views.sight import Sight

WINDOW_PX = 21
REACH_PX = 4  # of the search about the surface
CLEAR_PX = 3  # of the food's outline, which blur, resampling and compression spread
MIN_CORRELATION = 0.5
MIN_SHARE = 0.35  # of a window that must lie on the food
MIN_VARIANCE = 0.05  # grey levels squared: below it is rounding
MIN_NOISE = 0.15  # grey levels squared
SUBPIXEL_BITS = 4


@dataclass(frozen=True, slots=True)
class SurfaceParallax:
    """parallax_px, sd_px: (h, w) of a window of the grid whose first pixel is origin (x, y); NaN where unmeasured."""

    parallax_px: Float32Array
    sd_px: Float32Array
    origin: tuple[int, int]

    def at(self, pixels: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(n,) parallax and its sd at the nearest pixels; NaN outside."""
        column, row = (np.rint(pixels).astype(np.int64) - self.origin).T
        height, width = self.parallax_px.shape
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        out = np.full((2, len(pixels)), np.nan)
        out[0, inside] = self.parallax_px[row[inside], column[inside]]
        out[1, inside] = self.sd_px[row[inside], column[inside]]
        return out[0], out[1]


def measure_along(
    sight: Sight,
    grey: tuple[Float32Array, Float32Array],
    masks: tuple[MaskArray, MaskArray],
    vertices: Float64Array,
    mesh: Topology,
) -> SurfaceParallax | None:
    """The parallax near the surface; None where it is out of sight. grey, masks: both views, (H, W).

    Only what lies clear of the food's outline in both views takes part: a horizon is another place in either, but it
    is what correlates best.
    """
    drawn = draw_parallax(sight, vertices, mesh, masks[0].shape)
    if drawn is None:
        return None
    surface, (left, top) = drawn
    height, width = surface.shape
    window = (slice(top, top + height), slice(left, left + width))
    clear = _eroded(masks[0][window], CLEAR_PX), _eroded(masks[1], CLEAR_PX + REACH_PX)
    detail = [
        fine_detail(each, _eroded(mask, CLEAR_PX)) for each, mask in zip(grey, masks, strict=True)
    ]
    offset, sd = _correlate(detail[0][window], detail[1], surface, clear, (left, top))
    return SurfaceParallax(surface + _evened(offset, sd), sd, (left, top))


def _evened(offset: Float32Array, sd: Float32Array) -> Float32Array:
    """The mean over a few pixels, which a window's error is common to, by precision, where there is a value."""
    precision = np.nan_to_num(1 / (sd * sd))
    side = (TUNING.averaged_along_px, TUNING.averaged_along_px)
    total, weight = (
        cv2.blur(picture, side, borderType=cv2.BORDER_CONSTANT)
        for picture in (np.nan_to_num(offset) * precision, precision)
    )
    mean = total / np.maximum(weight, np.float32(1e-6))
    return np.where(np.isfinite(offset), mean, np.float32(np.nan)).astype(np.float32)


def average_along(
    sight: Sight,
    depth: DisparityMap,
    inward_px: Float32Array,
    vertices: Float64Array,
    mesh: Topology,
) -> SurfaceParallax | None:
    """The parallax of a depth map near the surface, averaged along it over a window; None where it is out of sight.

    inward_px: (H, W) distance to the food's outline; only what is clear of it by the map's reach takes part. A window
    speaks for all its pixels, as one of the photographs does, so that a map's noise neither adds observations nor draws
    the form. The sd is the noise that this leaves, and what the food itself departs from its form.
    """
    drawn = draw_parallax(sight, vertices, mesh, inward_px.shape)
    if drawn is None or depth.sd_px is None:
        return None
    surface, (left, top) = drawn
    window = (slice(top, top + surface.shape[0]), slice(left, left + surface.shape[1]))
    offset = depth.parallax_px[window] - surface
    is_own = np.isfinite(offset) & (inward_px[window] > depth.reach_px[window] + 1)
    count = _sum(is_own.astype(np.float32))
    is_good = np.isfinite(surface) & (count > MIN_SHARE * WINDOW_PX**2)
    count = np.maximum(count, np.float32(1.0))
    mean = _sum(np.where(is_own, offset, np.float32(0.0))) / count
    variance = _sum(np.where(is_own, depth.sd_px[window], np.float32(0.0)) ** 2) / count
    variance /= np.maximum(count / np.float32(depth.error_area_px or 1.0), 1)
    depth_mm = np.median((vertices - sight.cameras_mm[0]) @ sight.pair.rotation[2], keepdims=True)
    run_px = TUNING.roughness_run_mm * float(sight.pair.focal_px / depth_mm[0])
    rough_px = (
        TUNING.roughness_mm
        * float(sight.parallax_per_mm(depth_mm)[0])
        * min(1.0, run_px / WINDOW_PX)
    )
    sd = np.sqrt(variance + np.float32(rough_px) ** 2)
    nan = np.float32(np.nan)
    parallax, sd = (
        np.where(is_good, each, nan).astype(np.float32) for each in (surface + mean, sd)
    )
    return SurfaceParallax(parallax, sd, (left, top))


def draw_parallax(
    sight: Sight, vertices: Float64Array, mesh: Topology, shape: tuple[int, ...]
) -> tuple[Float32Array, tuple[int, int]] | None:
    """(h, w) parallax of the surface as the first view sees it, NaN beside it, and the window's origin (x, y).

    Parallax is affine over a plane triangle, as inverse depth is.
    """
    pixels, parallax = sight.project(vertices)
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(np.int64) - 1, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(np.int64) + 2, [shape[1], shape[0]])
    faces = mesh.faces[faces_towards(vertices, mesh.faces, sight.cameras_mm[0])]
    if len(faces) == 0 or (high - low < 4).any():
        return None
    faces = faces[np.argsort(parallax.take(faces).mean(axis=1))]  # the nearest are drawn last
    corners = pixels.take(faces, axis=0) - low
    number = np.full((int(high[1] - low[1]), int(high[0] - low[0])), -1, np.int32)
    for index, corner in enumerate(fixed_point(corners)):
        cv2.fillConvexPoly(number, corner, index, cv2.LINE_8, SUBPIXEL_BITS)
    system = np.concatenate([corners, np.ones((len(faces), 3, 1))], axis=2)
    system[np.abs(np.linalg.det(system)) < 1e-6] = np.eye(3)
    planes = np.linalg.solve(system, parallax[faces][:, :, None])[:, :, 0]
    rows, columns = np.nonzero(number >= 0)
    which = number[rows, columns]
    value = planes[which, 0] * columns + planes[which, 1] * rows + planes[which, 2]
    of_corners = parallax[faces][which]
    out = np.full(number.shape, np.nan, np.float32)
    out[rows, columns] = np.clip(value, of_corners.min(axis=1), of_corners.max(axis=1))
    return out, (int(low[0]), int(low[1]))


def fine_detail(grey: Float32Array, mask: MaskArray) -> Float32Array:
    """Return (H, W) grey levels of a food less their local mean, 0 beside it.

    Gloss changes slowly over a food and moves with the camera; the mean takes it away.
    Beyond the mask grey goes on as within it, so that the food's contrast with what lies behind it, which is at another
    place in either view, is no detail of its surface.
    """
    out = np.zeros(grey.shape, np.float32)
    if not mask.any():
        return out
    window = window_around(mask, round(2 * TUNING.detail_px))
    grey, mask = grey[window], mask[window]
    place = np.indices(mask.shape)
    _, labels = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    place_of = np.zeros((2, int(labels.max()) + 1), np.int64)
    place_of[:, labels[mask]] = place[:, mask]
    edge = place_of[:, labels]
    row, column = np.clip(2 * edge - place, 0, np.array(mask.shape)[:, None, None] - 1)
    beyond = grey[edge[0], edge[1]]
    beyond = np.where(mask[row, column], 2 * beyond - grey[row, column], beyond)
    mean = blurred(np.where(mask, grey, beyond), TUNING.detail_px)
    out[window] = np.where(mask, grey - mean, np.float32(0.0))
    return out


def _eroded(mask: MaskArray, across_px: int) -> MaskArray:
    """The mask less CLEAR_PX above and below, and across_px along the rows, which are searched."""
    out = np.zeros(mask.shape, np.bool_)
    window = window_around(mask, 0)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * across_px + 1, 2 * CLEAR_PX + 1))
    inner = mask[window].astype(np.uint8)
    out[window] = cv2.erode(inner, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return out


def draw_mask(pixels: Float64Array, faces: IntArray, shape: tuple[int, ...]) -> MaskArray:
    """(H, W) what triangles with corners at (n, 2) px cover."""
    out = np.zeros(shape, np.uint8)
    for corner in fixed_point(pixels.take(faces, axis=0)):
        cv2.fillConvexPoly(out, corner, 1, cv2.LINE_8, SUBPIXEL_BITS)
    return out > 0


def fixed_point(pixels: Float64Array) -> NDArray[np.int32]:
    """The places with SUBPIXEL_BITS of a fraction, as OpenCV draws them."""
    return np.rint(pixels * (1 << SUBPIXEL_BITS)).astype(np.int32)


def _correlate(
    first: Float32Array,
    second: Float32Array,
    surface: Float32Array,
    masks: tuple[MaskArray, MaskArray],
    origin: tuple[int, int],
) -> tuple[Float32Array, Float32Array]:
    """(h, w) by how much the parallax differs from the surface's, and its sd, by masked NCC and a parabola.

    The sd is what noise of the size that the correlation shows makes of the place of the peak. masks: of the first
    view's window and of the whole second view.
    """
    height, width = surface.shape
    rows, columns = (
        np.ascontiguousarray(each, np.float32)
        for each in np.meshgrid(
            np.arange(height) + origin[1], np.arange(width) + origin[0], indexing="ij"
        )
    )
    columns -= np.nan_to_num(surface)
    on_second = cv2.remap(masks[1].astype(np.uint8), columns, rows, cv2.INTER_NEAREST) > 0
    on_food = (np.isfinite(surface) & masks[0] & on_second).astype(np.float32)
    share = np.maximum(_sum(on_food), np.float32(1e-3))
    mean = _sum(first * on_food) / share
    variance = _sum(first * first * on_food) / share - mean * mean
    scores = np.empty((2 * REACH_PX + 1, height, width), np.float32)
    for score, shift in zip(scores, range(-REACH_PX, REACH_PX + 1), strict=True):
        moved = cv2.remap(
            second,
            columns - np.float32(shift),
            rows,
            cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        mean_moved = _sum(moved * on_food) / share
        variance_moved = _sum(moved * moved * on_food) / share - mean_moved * mean_moved
        covariance = _sum(first * moved * on_food) / share - mean * mean_moved
        spread = np.sqrt(
            np.maximum(variance, MIN_VARIANCE) * np.maximum(variance_moved, MIN_VARIANCE)
        )
        np.divide(covariance, spread, out=score)
    best = scores.argmax(axis=0)
    peak = np.clip(best, 1, 2 * REACH_PX - 1)
    less, here, more = (
        np.take_along_axis(scores, (peak + side)[None], axis=0)[0] for side in (-1, 0, 1)
    )
    curvature = np.minimum(less - 2 * here + more, -1e-6)
    offset = peak - REACH_PX + np.clip(0.5 * (less - more) / curvature, -1, 1)
    # The peak is as sharp as the gradients along the rows are strong, less those of the noise itself.
    noise = np.maximum((1 - np.clip(here, 0, 1)) * variance, MIN_NOISE)
    gradient = np.gradient(first, axis=1).astype(np.float32)
    sharpness = _sum(gradient * gradient * on_food) - share * noise / 2
    sd = 2 * np.sqrt(noise / np.maximum(sharpness, np.float32(1e-6)))
    is_good = (
        (on_food > 0)
        & (best == peak)
        & (here > MIN_CORRELATION)
        & (share > MIN_SHARE * WINDOW_PX**2)
    )
    nan = np.float32(np.nan)
    return np.where(is_good, offset, nan).astype(np.float32), np.where(is_good, sd, nan).astype(
        np.float32
    )


def _sum(image: Float32Array) -> Float32Array:
    side = (WINDOW_PX, WINDOW_PX)
    return np.asarray(
        cv2.boxFilter(image, cv2.CV_32F, side, normalize=False, borderType=cv2.BORDER_CONSTANT),
        np.float32,
    )
