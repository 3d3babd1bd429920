"""Whether a photograph is fit to be measured: too dark, or blurred.

Judged on the marker's own edges where it was found; on the whole photograph where it was not, to tell why.
"""

import cv2
import numpy as np

from app.core.errors import Failure
from app.vision.board.grid import square_means
from app.vision.board.tag_edges import edge_profiles, edge_width_px
from app.vision.model import Float64Array, ImageArray

DARK_LEVEL = 40.0  # of 255: paper that white is underexposed by four stops
# of the long side: 16 px in a 12 MP photograph, where a sharp phone gives 2 to 4
MAX_EDGE_WIDTH = 1 / 250
# of a square: beyond, the blurs of neighbouring edges mix and corners move
MAX_EDGE_WIDTH_SQUARES = 0.4
# every lens and demosaicing make edges of 3 to 5 px, in small photographs too
MIN_EDGE_WIDTH_LIMIT_PX = 8.0
UNKNOWN_WIDTH_PX = 1000.0  # OpenCV says 9999 where squares are too small for it to follow an edge
CLIPPED_LEVEL = 252  # of 255: JPEG moves full white by a few levels
MIN_EDGE_CONTRAST = 25.0  # grey levels across an edge for its width to be measured

DARK_ADVICE = (
    "Turn on a light or move the plate to a brighter place, then take both photographs again."
)
BLUR_ADVICE = "Hold the phone still with both hands, wait until it has focused, then take the photograph again."


def judge_photograph(grey: ImageArray, where: str) -> Failure | None:
    """Dark or blurred as a whole; None if it is neither. grey: (H, W); where: such as "in the left photograph"."""
    if np.percentile(grey[::4, ::4], 98) < DARK_LEVEL:
        return Failure("image_too_dark", f"It is too dark {where} to see the marker.", DARK_ADVICE)
    width = sharpest_edge_width_px(grey)
    if width > edge_width_limit_px(max(grey.shape)):
        return Failure(
            "image_blurred",
            f"Everything is blurred {where}: no edge is sharper than {width:.0f} px.",
            BLUR_ADVICE,
        )
    return None


def judge_marker(contrast: ImageArray, grid: Float64Array, where: str) -> Failure | None:
    """Dark or blurred by the marker's own squares; None if it is neither. grid: (r, c, 2) inner corners, px."""
    if np.nanmax(square_means(contrast, grid)) < DARK_LEVEL:
        return Failure(
            "image_too_dark",
            f"It is too dark {where}: the marker's white paper is almost black.",
            DARK_ADVICE,
        )
    width = marker_edge_width_px(contrast, grid)
    diagonal = np.linalg.norm(grid[1:, 1:] - grid[:-1, :-1], axis=-1).mean() / np.sqrt(2.0)
    if (
        width > edge_width_limit_px(max(contrast.shape))
        or width > MAX_EDGE_WIDTH_SQUARES * diagonal
    ):
        return Failure(
            "image_blurred",
            f"The marker is blurred {where}: its edges are {width:.0f} px wide.",
            BLUR_ADVICE,
        )
    return None


def judge_tags(
    grey: ImageArray, corners_px: Float64Array, border_share: float, where: str
) -> Failure | None:
    """Dark or blurred by the borders of a board's tags, (n, 4, 2) px; None if it is neither. As tag_edges."""
    profiles = edge_profiles(grey, corners_px, border_share)
    if profiles.light.max() < DARK_LEVEL:
        return Failure(
            "image_too_dark",
            f"It is too dark {where}: the marker's white paper is almost black.",
            DARK_ADVICE,
        )
    width = edge_width_px(profiles)
    if width > edge_width_limit_px(max(grey.shape)):
        return Failure(
            "image_blurred",
            f"The marker is blurred {where}: its edges are {width:.0f} px wide.",
            BLUR_ADVICE,
        )
    return None


def sharpest_edge_width_px(grey: ImageArray) -> float:
    """Width of the sharpest edges, px: contrast of the neighbourhood over its steepest step; inf without any edge.

    The tenth percentile over blocks that have contrast, so that a few hot pixels do not count as sharp.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    block = max(16, round(max(grey.shape) / 64))
    rows, columns = (side // block for side in grey.shape)
    tiles = _blocks(smooth, rows, columns, block)
    contrast = tiles.max(axis=(1, 3)).astype(np.float64) - tiles.min(axis=(1, 3))
    steps = np.maximum(
        cv2.absdiff(smooth[:, 1:], smooth[:, :-1])[:-1],
        cv2.absdiff(smooth[1:], smooth[:-1])[:, :-1],
    )
    steps = cv2.copyMakeBorder(steps, 0, 1, 0, 1, cv2.BORDER_REPLICATE)
    steepest = _blocks(steps, rows, columns, block).max(axis=(1, 3)).astype(np.float64)
    edged = contrast >= MIN_EDGE_CONTRAST
    if not edged.any():
        return float("inf")
    return float(np.percentile(contrast[edged] / np.maximum(steepest[edged], 1.0), 10))


def marker_edge_width_px(contrast: ImageArray, grid: Float64Array) -> float:
    """Mean width of the edges between the marker's squares, px, from a tenth to nine tenths of the step.

    Of squares too small for that, the width of the sharpest edges between the outermost corners.
    contrast: (H, W). grid: (r, c, 2) inner corners, px.
    """
    rows, columns = grid.shape[:2]
    corners = np.ascontiguousarray(grid.reshape(-1, 1, 2), np.float32)
    mean, _ = cv2.estimateChessboardSharpness(contrast, (columns, rows), corners)
    width_px = float(np.ravel(mean)[0])
    if width_px < UNKNOWN_WIDTH_PX:
        return width_px
    (left, top), (right, bottom) = corners[:, 0].min(axis=0), corners[:, 0].max(axis=0)
    return sharpest_edge_width_px(contrast[int(top) : int(bottom), int(left) : int(right)])


def edge_width_limit_px(long_side_px: float) -> float:
    """The widest that edges may be in a photograph of this size, px."""
    return max(MIN_EDGE_WIDTH_LIMIT_PX, MAX_EDGE_WIDTH * float(long_side_px))


def clipped_share(pixels_bgr: ImageArray) -> float:
    """Share of the photograph that is white to the limit of all three channels: nothing is to be seen there."""
    thinned = pixels_bgr[::4, ::4]
    return float(np.mean(thinned.min(axis=2) >= CLIPPED_LEVEL))


def _blocks(image: np.ndarray, rows: int, columns: int, block: int) -> ImageArray:
    """(rows, block, columns, block) view of an image cut to whole blocks."""
    return image[: rows * block, : columns * block].reshape(rows, block, columns, block)
