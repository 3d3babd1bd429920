"""The grid of a checkerboard in one contrast image: corners found, refined to sub-pixel, and checked square by square.

(H, W) uint8 in -> (rows, columns, 2) inner corners in px out, as the detector numbers them; which corner is which on
the print is left to marker.py. Detector: OpenCV's sector-based one (Duda and Frese, 2018), on a reduced image first.
"""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from app.vision.model import Float64Array, ImageArray

DETECTION_LONG_SIDES_PX = (1400, 2400, 4600)  # quick and blind to fine texture first; 4600 is all of a 12 MP photograph
MAX_RESIDUAL_SQUARES = 0.12  # of a square; lens distortion and curled paper bend a true grid by far less
MIN_ALTERNATING_SHARE = 0.9  # of neighbouring squares; a shadow's edge may upset a few
MIN_SQUARE_STEP = 8.0  # grey levels between the means of neighbouring squares; noise of a phone's dark areas is below 4
REFINEMENT_WINDOW_SQUARES = 0.3  # of a square's shorter side on either side of a corner: no other corner comes near
REFINEMENT_WINDOW_PX = (2, 13)
SQUARE_SAMPLES = np.stack(np.meshgrid(np.linspace(-0.22, 0.22, 5), np.linspace(-0.22, 0.22, 5)), -1).reshape(-1, 2)


def find_grid(contrast: ImageArray, columns: int, rows: int, *, larger: bool = False) -> Iterator[Float64Array]:
    """Grids of at least columns x rows inner corners (exactly, unless larger), from the most reduced image upwards.

    contrast: (H, W). Yields (r, c, 2), px of contrast; unrefined, unchecked.
    """
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | (cv2.CALIB_CB_LARGER if larger else 0)
    previous = None
    for long_side in DETECTION_LONG_SIDES_PX:
        scale = min(1.0, long_side / max(contrast.shape))
        if scale == previous:
            return
        previous = scale
        reduced = (
            contrast if scale == 1.0 else cv2.resize(contrast, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        )
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(reduced, (columns, rows), flags)
        if found:
            shape = np.asarray(meta).shape if larger else (rows, columns)
            grid = np.asarray(corners, np.float64).reshape(*shape, 2)
            yield (grid + 0.5) / scale - 0.5


def refine_grid(image: ImageArray, grid: Float64Array) -> Float64Array:
    """Corners where the edges that meet there cross (Foerstner's operator); image at full size.

    image: (H, W) uint8 or float32. grid: (r, c, 2), within some 2 px. Returns (r, c, 2).
    """
    window = int(np.clip(REFINEMENT_WINDOW_SQUARES * shortest_step_px(grid), *REFINEMENT_WINDOW_PX))
    start = np.ascontiguousarray(grid.reshape(-1, 1, 2), np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 0.001)
    # A crop, for the time and so that float32 px keep their last digits; 40 px leave room for the window.
    origin = np.maximum(np.floor(start.reshape(-1, 2).min(axis=0)) - 40, 0).astype(int)
    end = np.ceil(start.reshape(-1, 2).max(axis=0)).astype(int) + 40
    crop = np.ascontiguousarray(image[origin[1] : end[1], origin[0] : end[0]])
    refined = cv2.cornerSubPix(crop, start - origin.astype(np.float32), (window, window), (-1, -1), criteria)
    return np.asarray(refined.reshape(grid.shape) + origin, np.float64)


def shortest_step_px(grid: Float64Array) -> float:
    """The shortest distance between neighbouring corners of (r, c, 2), px."""
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1).min()
    return float(min(across, down))


def grid_homography(grid: Float64Array) -> tuple[Float64Array, float] | None:
    """(3, 3) mapping from (column, row) of inner corners to px, and its rms residual in squares; None if degenerate."""
    rows, columns = grid.shape[:2]
    index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2).astype(np.float64)
    homography: Any = cv2.findHomography(index, grid.reshape(-1, 2))[0]
    if homography is None:
        return None
    residual = np.linalg.norm(map_points(homography, index) - grid.reshape(-1, 2), axis=1)
    step = shortest_step_px(grid)
    if step < 2.0:
        return None
    return np.asarray(homography, np.float64), float(np.sqrt(np.mean(residual**2)) / step)


def map_points(homography: Float64Array, points: Float64Array) -> Float64Array:
    """(n, 2) points through a (3, 3) homography -> (n, 2)."""
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:], np.float64)


def square_means(image: ImageArray, grid: Float64Array, ring: int = 0) -> Float64Array:
    """Mean of the middle of every square, of `ring` squares' widths beyond the board's edge too.

    image: (H, W) or (H, W, k). grid: (r, c, 2). Returns (r + 1 + 2 ring, c + 1 + 2 ring[, k]); NaN outside the image.
    """
    fitted = grid_homography(grid)
    rows, columns = grid.shape[0] + 1 + 2 * ring, grid.shape[1] + 1 + 2 * ring
    if fitted is None:
        return np.full((rows, columns, *image.shape[2:]), np.nan)
    centres = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 1, 2) - 0.5 - ring
    where = map_points(fitted[0], (centres + SQUARE_SAMPLES).reshape(-1, 2))
    height, width = image.shape[:2]
    x, y = np.rint(where).astype(np.int64).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    values = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
    values[~inside] = np.nan
    means = values.reshape(rows, columns, len(SQUARE_SAMPLES), *image.shape[2:]).mean(axis=2)
    return np.asarray(means, np.float64)


def alternating_share(means: Float64Array) -> float:
    """Share of neighbouring squares whose means step the way that a checkerboard with a dark first square steps.

    means: (rows, columns), NaN counts as wrong. 1.0: all as they should; 0.0: all the other way (a light first square).
    """
    sign = np.where(np.indices(means.shape).sum(axis=0) % 2 == 0, -1.0, 1.0)
    steps = np.concatenate(
        [
            (np.diff(means, axis=1) * sign[:, 1:]).ravel(),
            (np.diff(means, axis=0) * sign[1:, :]).ravel(),
        ]
    )
    forward, backward = np.mean(steps > MIN_SQUARE_STEP), np.mean(steps < -MIN_SQUARE_STEP)
    return float(forward if forward >= backward else 1.0 - backward)


def is_checkerboard(contrast: ImageArray, grid: Float64Array) -> bool:
    """Whether a grid is regular up to perspective and its squares alternate; wallpaper and cloth do not."""
    fitted = grid_homography(grid)
    if fitted is None or fitted[1] > MAX_RESIDUAL_SQUARES:
        return False
    share = alternating_share(square_means(contrast, grid))
    return max(share, 1.0 - share) >= MIN_ALTERNATING_SHARE
