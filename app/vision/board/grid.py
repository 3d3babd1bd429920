"""The grid of a checkerboard in one contrast image: corners found, refined to sub-pixel, and checked square by square.

(H, W) uint8 in -> (rows, columns, 2) inner corners in px out, as the detector numbers them; which corner is which on
the print is left to marker.py. Detector: OpenCV's sector-based one (Duda and Frese, 2018), on a reduced image first.
"""

import cv2
import numpy as np

from app.vision.geometry.pictures import reduce_by
from app.vision.geometry.projective import map_points
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray

# of a square; lens distortion and curled paper bend a true grid by far less
MAX_RESIDUAL_SQUARES = 0.12
MIN_ALTERNATING_SHARE = 0.9  # of neighbouring squares; a shadow's edge may upset a few
MIN_SQUARE_STEP = 8.0  # grey levels between the means of neighbouring squares; noise of a phone's dark areas is below 4
# of a square's shorter side on either side of a corner: no other corner comes near
REFINEMENT_WINDOW_SQUARES = 0.3
REFINEMENT_WINDOW_PX = (3, 14)
# of the window: half width about an edge line, from the first step to the last
REFINEMENT_BANDS = (0.5, 0.2)
REFINEMENT_STEPS = 10
MAX_STRAY_SQUARES = 0.08  # of a square, from where the other corners expect one
MIN_CORNERS_FOR_CUBIC = 5  # a side
MAX_STRAY_SHARE = 0.35  # of the corners; above, it is the homography that is wrong
SQUARE_SAMPLES = np.stack(
    np.meshgrid(np.linspace(-0.22, 0.22, 5), np.linspace(-0.22, 0.22, 5)), -1
).reshape(-1, 2)


def reduced(contrast: ImageArray, long_side: int) -> tuple[ImageArray, float]:
    """The image with its long side at most this long, and its scale."""
    scale = min(1.0, long_side / max(contrast.shape))
    if scale == 1.0:
        return contrast, 1.0
    fewer = reduce_by(contrast, int(1.0 / scale))
    height, width = (max(1, round(side * scale)) for side in contrast.shape[:2])
    return np.asarray(
        cv2.resize(fewer, (width, height), interpolation=cv2.INTER_AREA), np.uint8
    ), scale


def refine_grid(image: ImageArray | Float32Array, grid: Float64Array) -> Float64Array:
    """Sub-pixel corners, (r, c, 2), of a grid that is right within some 2 px.

    A corner that strays from where the others expect it (the edge of a hard shadow runs through it) starts again from
    there, and may then move only so far.
    image: (H, W) uint8 or float32, full size.
    """
    refined = cross_edges(image, grid, None)
    expected = _smooth_grid(refined)
    tolerance_px = MAX_STRAY_SQUARES * shortest_step_px(grid)
    strays = np.linalg.norm(refined - expected, axis=-1) > tolerance_px
    if not strays.any() or np.mean(strays) > MAX_STRAY_SHARE:
        return refined
    again = cross_edges(image, np.where(strays[..., None], expected, refined), tolerance_px / 2)
    return np.where(strays[..., None], again, refined)


def _smooth_grid(grid: Float64Array) -> Float64Array:
    """Where the corners of (r, c, 2) would be by most of the others: a homography, and a cubic for lens and bent paper.

    The cubic is left out where there are too few corners for it; a board of so few squares bends little.
    """
    index = _places(*grid.shape[:2])
    homography = _homography(index, grid, cv2.LMEDS)
    if homography is None:
        return grid
    expected = map_points(homography, index)
    if min(grid.shape[:2]) < MIN_CORNERS_FOR_CUBIC:
        return expected.reshape(grid.shape)
    off = grid.reshape(-1, 2) - expected
    x, y = (2.0 * index / index.max(axis=0) - 1.0).T
    terms = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    scale_px = MAX_STRAY_SQUARES * shortest_step_px(grid) / 2
    weight = np.ones(len(off))
    for _ in range(20):  # Cauchy weights, by which strays lose their say
        fitted = (
            terms @ np.linalg.lstsq(terms * weight[:, None], off * weight[:, None], rcond=None)[0]
        )
        weight = 1.0 / np.sqrt(1.0 + np.sum((off - fitted) ** 2, axis=1) / scale_px**2)
    return np.asarray((expected + fitted).reshape(grid.shape), np.float64)


def cross_edges(
    image: ImageArray | Float32Array, grid: Float64Array, limit_px: float | None
) -> Float64Array:
    """Corners where the edges that meet there cross, by Foerstner's operator (1987) on the expected edges only.

    A plain Foerstner window also takes up the edge of a shadow that runs by; here a pixel counts by how near it lies to
    the grid's own lines through the corner, and by how well its gradient crosses them.
    limit_px: how far a corner may go from where it starts; None: as far as its window reaches.
    """
    reach = int(np.clip(REFINEMENT_WINDOW_SQUARES * shortest_step_px(grid), *REFINEMENT_WINDOW_PX))
    pad = 2 * reach + 3
    low = np.clip(np.floor(grid.min(axis=(0, 1))).astype(int) - pad, 0, None)
    high = np.ceil(grid.max(axis=(0, 1))).astype(int) + pad + 1
    crop = cv2.copyMakeBorder(
        image[low[1] : high[1], low[0] : high[0]].astype(np.float32),
        pad,
        pad,
        pad,
        pad,
        cv2.BORDER_REPLICATE,
    )
    slope_x, slope_y = cv2.Scharr(crop, cv2.CV_32F, 1, 0), cv2.Scharr(crop, cv2.CV_32F, 0, 1)
    normals = _edge_normals(grid).astype(np.float32)[..., None]  # (n, 2, 2, 1)
    start = grid.reshape(-1, 2) - low + pad
    window = np.stack(
        np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)), -1
    ).reshape(-1, 2)
    limit = float(reach) if limit_px is None else limit_px
    corners = start.copy()
    for band in np.linspace(*REFINEMENT_BANDS, REFINEMENT_STEPS) * reach:
        nearest = np.rint(corners).astype(int)
        columns, rows = nearest[:, :1] + window[:, 0], nearest[:, 1:] + window[:, 1]  # (n, k)
        gx, gy = slope_x[rows, columns], slope_y[rows, columns]
        dx, dy = (
            (at - corner[:, None]).astype(np.float32)
            for at, corner in zip((columns, rows), corners.T, strict=True)
        )
        strength = np.maximum(gx * gx + gy * gy, np.float32(1e-6))
        near = np.zeros_like(gx)
        for edge in (0, 1):
            distance = normals[:, edge, 0] * dx + normals[:, edge, 1] * dy
            across = normals[:, edge, 0] * gx + normals[:, edge, 1] * gy
            share = across * across / strength
            np.maximum(
                near,
                np.exp(distance * distance * np.float32(-0.5 / max(1.5, band) ** 2))
                * share
                * share,
                out=near,
            )
        weight = near * np.exp((dx * dx + dy * dy) * np.float32(-0.5 / (0.6 * reach) ** 2))
        xx, xy, yy = (
            (weight * product).sum(axis=1, dtype=np.float64)
            for product in (gx * gx, gx * gy, gy * gy)
        )
        along = gx * dx + gy * dy
        moment = np.stack(
            [(weight * g * along).sum(axis=1, dtype=np.float64) for g in (gx, gy)], axis=-1
        )
        # A trace of the identity keeps a corner without texture where it is.
        ridge = 1e-6 * (xx + yy) + 1e-9
        tensor = np.stack([np.stack([xx + ridge, xy], -1), np.stack([xy, yy + ridge], -1)], axis=-2)
        step = np.linalg.solve(tensor, moment[..., None])[..., 0]
        corners = np.clip(corners + step, start - limit, start + limit)
    return np.asarray((corners + low - pad).reshape(grid.shape), np.float64)


def _edge_normals(grid: Float64Array) -> Float64Array:
    """(n, 2, 2) unit normals of the two edges through every corner of (r, c, 2): of its row's, of its column's."""
    along = np.stack([np.gradient(grid, axis=1), np.gradient(grid, axis=0)], axis=2).reshape(
        -1, 2, 2
    )
    normals = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True), np.float64)


def shortest_step_px(grid: Float64Array) -> float:
    """The shortest distance between neighbouring corners of (r, c, 2), px."""
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1).min()
    return float(min(across, down))


def grid_homography(grid: Float64Array) -> tuple[Float64Array, float] | None:
    """(3, 3) mapping from (column, row) of inner corners to px, and its rms residual in squares; None if degenerate."""
    index, step = _places(*grid.shape[:2]), shortest_step_px(grid)
    homography = _homography(index, grid)
    if homography is None or step < 2.0:
        return None
    residual = np.linalg.norm(map_points(homography, index) - grid.reshape(-1, 2), axis=1)
    return homography, float(np.sqrt(np.mean(residual**2)) / step)


def _places(rows: int, columns: int) -> Float64Array:
    """(rows * columns, 2) column and row of each cell, row-major."""
    return (
        np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1)
        .reshape(-1, 2)
        .astype(np.float64)
    )


def _homography(index: Float64Array, grid: Float64Array, method: int = 0) -> Float64Array | None:
    """(3, 3) from places (n, 2) to a grid's px; None if degenerate, for which OpenCV's stub has no type."""
    matrices = [cv2.findHomography(index, grid.reshape(-1, 2), method)[0]]
    return next((np.asarray(matrix, np.float64) for matrix in matrices if matrix is not None), None)


def sample_squares(
    image: ImageArray,
    homography: Float64Array,
    size: tuple[int, int],
    offsets: Float64Array,
    ring: int,
) -> tuple[np.ndarray, MaskArray] | None:
    """Pixels around the middle of every square, of `ring` squares' widths beyond the board's edge too.

    image: (H, W) or (H, W, k). size: (rows, columns) of squares with the ring. offsets: (n, 2) squares from the middle.
    Returns (rows, columns, n[, k]) and (rows, columns, n) whether each lies inside the image; None where a place is
    not finite.
    """
    centres = _places(*size)[:, None] - 0.5 - ring
    places = np.rint(map_points(homography, (centres + offsets).reshape(-1, 2)))
    if not np.isfinite(places).all():
        return None
    height, width = image.shape[:2]
    x, y = np.clip(places, -1, [width, height]).astype(np.int64).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    values = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    shape = (*size, len(offsets))
    return values.reshape(*shape, *image.shape[2:]), inside.reshape(shape)


def square_means(image: ImageArray, grid: Float64Array, ring: int = 0) -> Float64Array:
    """Mean of the middle of every square, of `ring` squares' widths beyond the board's edge too.

    image: (H, W) or (H, W, k). grid: (r, c, 2). Returns (r + 1 + 2 ring, c + 1 + 2 ring[, k]); NaN outside the image.
    """
    size = (grid.shape[0] + 1 + 2 * ring, grid.shape[1] + 1 + 2 * ring)
    fitted = grid_homography(grid)
    sampled = (
        None if fitted is None else sample_squares(image, fitted[0], size, SQUARE_SAMPLES, ring)
    )
    if sampled is None:
        return np.full((*size, *image.shape[2:]), np.nan)
    values = sampled[0].astype(np.float64)
    values[~sampled[1]] = np.nan
    return np.asarray(values.mean(axis=2), np.float64)


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
