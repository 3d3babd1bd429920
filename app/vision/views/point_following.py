"""Points of one picture followed to the other: what hardly moved between them, or begins near where it is.

Two grey pictures of even light, places and first guesses -> places in the second, to a twentieth of a pixel.
"""

import cv2
import numpy as np

from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray
from app.vision.tuning import FLOW_TUNING as TUNING


def evenly_lit(grey: ImageArray) -> ImageArray:
    """Return the picture (H, W) with the same mean and contrast everywhere: light and exposure differ between views."""
    smooth = cv2.GaussianBlur(grey, (0, 0), TUNING.noise_blur_px).astype(np.float32)
    side = (TUNING.even_px, TUNING.even_px)
    mean = cv2.blur(smooth, side)
    spread = np.sqrt(np.maximum(cv2.blur(smooth * smooth, side) - mean * mean, 0.0))
    even = TUNING.level + TUNING.contrast * (smooth - mean) / (spread + TUNING.noise_levels)
    return np.clip(even, 0, 255).astype(np.uint8)


def corners_of(picture: ImageArray, mask: ImageArray) -> Float64Array:
    """Return (n, 2) px of the most textured places (Shi and Tomasi, 1994), spread over where mask is not 0."""
    corners = cv2.goodFeaturesToTrack(
        picture,
        TUNING.corners,
        TUNING.corner_quality,
        TUNING.corners_apart_px,
        mask=mask,
        blockSize=TUNING.corner_px,
    )
    return np.empty((0, 2)) if corners is None else corners[:, 0].astype(np.float64)


def follow_points(
    first: ImageArray, second: ImageArray, at: Float64Array, guess: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return those of (n, 2) px of the first picture that are found in the second, and where, from a guess (n, 2).

    By Lucas and Kanade (Bouguet, 2000). What is followed back has to come to where it began.
    """
    if len(at) == 0:
        return at, guess
    places, start = (np.asarray(points, np.float32)[:, None] for points in (at, guess))
    moved, is_like = _follow(first, second, places, start)
    back, is_like_back = _follow(second, first, moved, moved + places - start)
    off_px = np.linalg.norm(back - places, axis=-1)[:, 0]
    is_found = is_like & is_like_back & (off_px < TUNING.most_return_px)
    return at[is_found], moved[is_found, 0].astype(np.float64)


def _follow(
    first: ImageArray, second: ImageArray, places: Float32Array, start: Float32Array
) -> tuple[Float32Array, MaskArray]:
    """Return (n, 1, 2) px in the second picture, and (n,) whether the windows there look alike."""
    stop = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS
    moved, is_seen, unlike = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        places,
        start.copy(),
        winSize=(TUNING.window_px, TUNING.window_px),
        maxLevel=TUNING.levels,
        criteria=(stop, TUNING.most_rounds, TUNING.least_step_px),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=TUNING.least_texture,
    )
    is_like = (np.asarray(is_seen) > 0) & (np.asarray(unlike) < TUNING.most_unlike)
    return np.asarray(moved, np.float32), is_like[:, 0]
