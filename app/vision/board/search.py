"""Where in a photograph a checkerboard may lie, and the whole grid of its inner corners, whatever its size.

Contrast image in -> candidate grids out, quick ones first. Which board it is and which corner is which is for
marker.py. Corners of squares are saddle points of the grey levels. OpenCV's sector-based detector
(Duda and Frese, 2018) runs only where many of them lie together. Textures have many saddle points,
too, but hardly one between corners of the opposite kind. Without such a point no detector runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.board.grid import (
    cross_edges,
    grid_homography,
    is_checkerboard,
    reduced,
    shortest_step_px,
    square_means,
)
from app.vision.geometry.projective import map_points
from app.vision.model import Float32Array, Float64Array, ImageArray, Int64Array

# long side on which saddle points are sought: squares of 5 px and more have them
REGION_SIDE_PX = 1000
SADDLE_BLUR_PX = 1.5
MIN_SADDLE_STEP = 6.0  # grey levels between dark and light squares; board_grid.MIN_SQUARE_STEP for a sharp corner is 8
MIN_SADDLE_SHARE = 0.2  # of the strong ones' step: the part of a board that lies in a shadow
MIN_SADDLES = 9  # in a region: 4 x 4 squares have as many
# x, y of half of the 16 pixels that FAST compares with a corner (Rosten and Drummond, 2006). Their
# radius of 3 px lies within squares of 5 px.
ARC = ((0, -3), (1, -3), (2, -2), (3, -1), (3, 0), (3, 1), (2, 2), (1, 3))
CIRCLE = np.array([*ARC, *((-x, -y) for x, y in ARC)])
CIRCLE_BLUR_PX = 0.7  # against noise
# Standard deviation on the circle over the saddle point's step. Corners have 0.43 to 0.52, and up to
# 0.65 between squares of several colours. Fine textures end within the circle and often have more.
MAX_SPREAD = 0.7
OPPOSITE = -0.75  # correlation of two circles: -1 on an ideal board, -0.8 in a strong blur
NEIGHBOURS = 8  # nearest ones; both along each edge are among them up to a tilt of 70 degrees
# How far two neighbours may be from lying opposite each other: by perspective, as a share of the
# distance, and by rounding to whole pixels.
MAX_OFF_CENTRE, MAX_OFF_CENTRE_PX = 0.2, 1.5
KDTREE_SINGLE = 4  # of cv::flann::KDTreeSingleIndexParams
# Of the long side: saddle points nearer than twice that belong to one region. A board beside a plate has squares of a
# fortieth and less; one that fills the photograph, as for calibration, of a tenth.
JOINED_SHARES = (1 / 40, 1 / 12)
# of either kind, with the most saddle points; a chequered cloth beside the board is one
MAX_REGIONS = 2
SAME_REGION = 0.8  # of the larger one's area
ALL_OF_IT = 0.5  # of the photograph: a region beyond it saves nothing, and a shadow may hide the rest of the board
# long side of a region for the detectors; twice that where it is the whole photograph
CROP_SIDE_PX = 500
# Local thresholds find quadrangles in uneven light: 5 ms a crop; up to a second where the whole photograph has texture.
QUICK_ON_CROPS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
# of the squares of an outermost row; beside a white margin half of them step
MIN_ALTERNATING_EDGE = 0.8
MAX_GROWTH = 80  # rows and columns
GROWN_CORNER_SQUARES = 0.3  # of a square: how far a corner may lie from where the others expect it


@dataclass(frozen=True, slots=True)
class _Region:
    """box: x, y, width, height in px of the image. is_likely: no other of its kind has more saddle points."""

    box: tuple[int, int, int, int]
    is_likely: bool


@dataclass(frozen=True, slots=True)
class _Crop:
    """A part of the contrast image, reduced by scale; origin: (x, y) px of the whole image, of its corner."""

    image: ImageArray
    origin: tuple[int, int]
    scale: float

    def in_whole(self, grid: Float64Array) -> Float64Array:
        """(r, c, 2) px of the crop -> px of the whole image."""
        return (grid + 0.5) / self.scale - 0.5 + self.origin


def find_grids(contrast: ImageArray, size: tuple[int, int] | None = None) -> Iterator[Float64Array]:
    """Candidates for whole boards: regular grids of alternating squares, (r, c, 2) px of contrast, unrefined.

    size: (columns, rows) of inner corners that are sought with more effort, after a grid of any size; None: any from
    3 x 3 up.
    """
    regions = _regions(contrast)
    crops = [_crop(contrast, region.box, CROP_SIDE_PX) for region in regions]
    wide = [
        _crop(contrast, region.box, 2 * CROP_SIDE_PX)
        for region in regions
        if region.box[2:] == contrast.shape[::-1]
    ]
    likely = [crop for crop, region in zip(crops, regions, strict=True) if region.is_likely]
    attempts: list[tuple[_Crop, tuple[int, int] | None, int]] = []
    attempts += [(crop, None, 0) for crop in (*wide, *crops)]
    if size is not None:
        attempts += [(crop, None, cv2.CALIB_CB_NORMALIZE_IMAGE) for crop in crops]
        attempts += [(crop, size, 0) for crop in likely]
    for crop, sought, flags in attempts:
        grid = _detect(crop.image, sought, flags)
        if grid is not None and is_checkerboard(crop.image, grid):
            whole = _without_margin(crop.image, grid) if sought is None else grid
            yield crop.in_whole(_with_all_squares(crop.image, whole))
    if size is None:
        return
    for crop, flags in [(crop, 0) for crop in wide] + [(crop, QUICK_ON_CROPS) for crop in crops]:
        grid = _detect_by_quadrangles(crop.image, size, flags)
        if grid is not None and is_checkerboard(crop.image, grid):
            yield crop.in_whole(grid)


def _crop(contrast: ImageArray, box: tuple[int, int, int, int], long_side: int) -> _Crop:
    x, y, width, height = box
    image, scale = reduced(contrast[y : y + height, x : x + width], long_side)
    return _Crop(image, (x, y), scale)


def _regions(contrast: ImageArray) -> list[_Region]:
    """Return where saddle points crowd, the most crowded first; nothing without a board's middle."""
    image, scale = reduced(contrast, REGION_SIDE_PX)
    step = _saddle_step(image)
    is_peak = (step == cv2.dilate(step, np.ones((5, 5), np.uint8))) & (step > MIN_SADDLE_STEP)
    y, x = np.nonzero(is_peak)
    if len(y) < MIN_SADDLES:
        return []
    kept = step[y, x] > MIN_SADDLE_SHARE * np.sort(step[y, x])[-MIN_SADDLES]
    y, x = y[kept], x[kept]
    if not _has_middle(image, np.column_stack([x, y]), step[y, x]):
        return []
    regions: list[_Region] = []
    for share in JOINED_SHARES:
        reach = max(3, round(share * max(image.shape)))
        near = np.zeros(image.shape, np.uint8)
        near[y, x] = 1
        joined = cv2.dilate(near, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        labels, label = cv2.connectedComponents(joined)
        crowd = np.bincount(label[y, x], minlength=labels)
        for place, index in enumerate(np.argsort(-crowd)[:MAX_REGIONS]):
            left, top, width, height = cv2.boundingRect((label == index).astype(np.uint8))
            box = _enlarged((left, top, width, height), 1.0 / scale, contrast.shape)
            if crowd[index] >= MIN_SADDLES and not any(
                _is_same(box, region.box) for region in regions
            ):
                regions.append(_Region(box, place == 0))
    return regions


def _has_middle(image: ImageArray, places: Int64Array, step: Float32Array) -> bool:
    """Return whether a saddle point is the middle of 3 x 3 corners, which every board has.

    Dark and light change places from one corner to the next. A middle lies between two corners of
    the opposite kind along both edges. At least three of these four lie between two as well: one
    may be covered.

    image: (H, W)
    places: (n, 2) x, y, px
    step: (n,) grey levels
    """
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), CIRCLE_BLUR_PX)
    around = np.clip(places[:, None] + CIRCLE, 0, np.array(image.shape[::-1]) - 1)
    levels = smooth[around[..., 1], around[..., 0]]
    # Opposite sectors are averaged: squares of a coloured board are unlike.
    levels = (levels + np.roll(levels, len(ARC), axis=1)) / 2
    levels -= levels.mean(axis=1, keepdims=True)
    is_corner = levels.std(axis=1) < MAX_SPREAD * step
    if np.count_nonzero(is_corner) <= NEIGHBOURS:
        return False
    points, looks = places[is_corner].astype(np.float32), levels[is_corner]
    looks /= np.maximum(np.linalg.norm(looks, axis=-1, keepdims=True), 1.0)
    tree = cv2.flann.Index(points, {"algorithm": KDTREE_SINGLE})
    near = tree.knnSearch(points, NEIGHBOURS + 1)[0][:, 1:]  # the first is the corner itself
    is_opposite = (looks[:, None] * looks[near]).sum(axis=-1) < OPPOSITE
    offset = points[near] - points[:, None]
    limit_px = np.maximum(MAX_OFF_CENTRE * np.linalg.norm(offset, axis=-1), MAX_OFF_CENTRE_PX)
    off_centre_px = np.linalg.norm(offset[:, :, None] + offset[:, None], axis=-1)  # of each two
    is_between = (off_centre_px < limit_px[..., None]) & is_opposite[..., None]
    rows = np.count_nonzero(is_between & is_opposite[:, None], axis=(1, 2)) / 2
    opposites_in_rows = np.count_nonzero(is_opposite & (rows[near] >= 1), axis=1)
    return bool(np.any((rows >= 2) & (opposites_in_rows >= 3)))


def _is_same(box: tuple[int, ...], other: tuple[int, ...]) -> bool:
    """Whether two boxes (x, y, width, height) share most of the larger one."""
    width, height = (
        min(box[i] + box[i + 2], other[i] + other[i + 2]) - max(box[i], other[i]) for i in (0, 1)
    )
    larger = max(box[2] * box[3], other[2] * other[3])
    return max(width, 0) * max(height, 0) >= SAME_REGION * larger


def _enlarged(
    box: tuple[int, int, int, int], factor: float, shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """The box in px of the whole image of this shape; all of it where the box takes up most of it."""
    if box[2] * box[3] * factor**2 > ALL_OF_IT * shape[0] * shape[1]:
        return 0, 0, shape[1], shape[0]
    left, top = int(box[0] * factor), int(box[1] * factor)
    right, bottom = (int(np.ceil((box[i] + box[i + 2]) * factor)) for i in (0, 1))
    return left, top, min(right, shape[1]) - left, min(bottom, shape[0]) - top


def _saddle_step(image: ImageArray) -> np.ndarray:
    """(H, W) step between dark and light of the checkerboard corner that would be as saddle-shaped; 0 at blobs, edges.

    An ideal corner of step C, blurred by s, has a second derivative of C / (pi s^2) along x y: the root of the
    Hessian's negative determinant, which does not depend on how the corner is turned.
    """
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), SADDLE_BLUR_PX)
    xx, yy, xy = (
        cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=0.25)
        for order in ((2, 0), (0, 2), (1, 1))
    )
    return np.sqrt(np.maximum(xy * xy - xx * yy, 0.0)) * np.float32(np.pi * SADDLE_BLUR_PX**2)


def _detect(image: ImageArray, size: tuple[int, int] | None, flags: int) -> Float64Array | None:
    """(r, c, 2) px of a grid of any size or, in four times the time where there is none, of this size.

    The detector's nearest-neighbour trees draw on OpenCV's generator: seeded here, the photograph alone decides.
    """
    cv2.setRNGSeed(0)
    if size is None:
        is_found, corners, meta = cv2.findChessboardCornersSBWithMeta(
            image, (3, 3), flags | cv2.CALIB_CB_LARGER
        )
        return (
            np.asarray(corners, np.float64).reshape(*np.asarray(meta).shape, 2)
            if is_found
            else None
        )
    is_found, exact = cv2.findChessboardCornersSB(image, size, flags=flags)
    return np.asarray(exact, np.float64).reshape(size[1], size[0], 2) if is_found else None


def _detect_by_quadrangles(
    image: ImageArray, size: tuple[int, int], flags: int
) -> Float64Array | None:
    """(r, c, 2) px by OpenCV's older detector, which joins dark quadrangles.

    It reads a board among other squares (ArUco tags, print), where the sector-based one locks on wrong corners.
    """
    is_found, corners = cv2.findChessboardCorners(
        image, size, flags=flags | cv2.CALIB_CB_FAST_CHECK
    )
    return np.asarray(corners, np.float64).reshape(size[1], size[0], 2) if is_found else None


def _without_margin(contrast: ImageArray, grid: Float64Array) -> Float64Array:
    """The grid less outermost rows and columns that do not alternate with their neighbours: margin."""
    for _ in range(MAX_GROWTH):
        means = square_means(contrast, grid)
        turns = [turn for turn in range(4) if _is_margin(np.rot90(means, turn))]
        if not turns or min(grid.shape[:2]) <= 3:
            break
        grid = np.rot90(np.rot90(grid, turns[0])[1:], -turns[0])
    return grid


def _is_margin(means: Float64Array) -> bool:
    """Whether of the squares of the top row that are in the image too few differ from their neighbours below."""
    seen = np.isfinite(means[0])
    return (
        int(np.count_nonzero(seen)) >= 4
        and _alternating_share(means[0], means[1]) < MIN_ALTERNATING_EDGE
    )


def _with_all_squares(contrast: ImageArray, grid: Float64Array) -> Float64Array:
    """The grid with the rows and columns that the detector left out, unrefined."""
    for _ in range(MAX_GROWTH):
        grown = _grown(contrast, grid)
        if grown is None:
            break
        grid = grown
    return grid


def _grown(contrast: ImageArray, grid: Float64Array) -> Float64Array | None:
    """The grid with one more row or column, where the squares beyond its edge go on alternating; None: nowhere."""
    means = square_means(contrast, grid, ring=1)
    for turn in range(4):
        if _continues_beyond(np.rot90(means, turn)):
            turned = np.rot90(grid, turn)
            fitted = grid_homography(turned)
            if fitted is None:
                return None
            columns = np.arange(turned.shape[1], dtype=np.float64)
            expected = map_points(
                fitted[0], np.column_stack([columns, np.full_like(columns, -1.0)])
            )
            edge = np.stack([expected, turned[0]])
            added = cross_edges(contrast, edge, GROWN_CORNER_SQUARES * shortest_step_px(edge))[:1]
            return np.rot90(np.concatenate([added, turned]), -turn)
    return None


def _continues_beyond(means: Float64Array) -> bool:
    """Whether squares of the ring's top row (row 0 of square_means with ring 1) go on alternating from row 1."""
    ring, edge = means[0, 1:-1], means[1, 1:-1]
    return bool(np.isfinite(ring).all()) and _alternating_share(ring, edge) >= MIN_ALTERNATING_EDGE


def _alternating_share(outer: Float64Array, inner: Float64Array) -> float:
    """Share of a row's squares that differ from their neighbours in the next row as a board's would; NaN left out."""
    step = inner - outer
    span = np.nanmean(np.abs(np.diff(inner)))
    sign = np.where(np.arange(len(inner)) % 2 == 0, 1.0, -1.0)
    signed = (step * sign)[np.isfinite(step)]
    return float(max(np.mean(signed > span / 2), np.mean(signed < -span / 2)))
