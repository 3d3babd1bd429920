"""Small operations on masks, (H, W) bool, that several steps of the segmentation need."""

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.model import Float32Array, Float64Array, MaskArray

FAR_PX = 1e6  # distance from nothing


def labelled(
    mask: MaskArray, connectivity: Literal[4, 8] = 8
) -> tuple[NDArray[np.int32], NDArray[np.int32], Float64Array]:
    """(H, W) number of each pixel's connected part, from 1 on; by number x, y, width, height, area; and the middles.

    Of 0, what lies beside all parts, nothing is told.
    """
    labels = np.zeros(mask.shape, np.int32)
    window = window_around(mask, 0)  # OpenCV would measure what lies beside the mask as well
    _, labels[window], stats, middles = cv2.connectedComponentsWithStats(
        mask[window].astype(np.uint8), connectivity=connectivity
    )
    low = [window[1].start, window[0].start]
    stats[:, :2] += low
    return labels, np.asarray(stats, np.int32), np.asarray(middles + low, np.float64)


def without_specks(mask: MaskArray, least_px: float) -> MaskArray:
    """The mask's connected parts of at least this area, px."""
    labels, stats, _ = labelled(mask)
    kept = stats[:, cv2.CC_STAT_AREA] >= least_px
    kept[0] = False
    return kept.take(labels)


def opened(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask without what is narrower than a square of this side."""
    return _morphed(mask, cv2.MORPH_OPEN, size_px)


def closed(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask with its gaps that are narrower than a square of this side."""
    return _morphed(mask, cv2.MORPH_CLOSE, size_px)


def dilated(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask grown by a square of this side."""
    return _morphed(mask, cv2.MORPH_DILATE, size_px)


def eroded(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask shrunk by a square of this side."""
    return _morphed(mask, cv2.MORPH_ERODE, size_px)


def _morphed(mask: MaskArray, operation: int, size_px: int) -> MaskArray:
    kernel = np.ones((size_px, size_px), np.uint8)
    return cv2.morphologyEx(mask.astype(np.uint8), operation, kernel) > 0


def window_around(mask: MaskArray, margin_px: int) -> tuple[slice, slice]:
    """Rows and columns of a mask with a margin; one pixel where it is empty."""
    if not mask.any():
        return slice(0, 1), slice(0, 1)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(0, int(rows[0]) - margin_px), min(mask.shape[0], int(rows[-1]) + 1 + margin_px)),
        slice(
            max(0, int(columns[0]) - margin_px),
            min(mask.shape[1], int(columns[-1]) + 1 + margin_px),
        ),
    )


def largest_part(mask: MaskArray) -> MaskArray:
    """The largest connected part."""
    labels, stats, _ = labelled(mask)
    return labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()) if len(stats) > 1 else mask


def filled(mask: MaskArray) -> MaskArray:
    """Return the mask with its holes."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    picture = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(picture, contours, -1, (1.0,), -1)
    return picture > 0


def touching(mask: MaskArray, seeds: MaskArray) -> MaskArray:
    """The connected parts of the mask that hold a seed."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8))
    return mask & np.isin(labels, np.unique(labels[seeds & mask]))


def distance_px(mask: MaskArray) -> Float32Array:
    """(H, W) distance to the nearest pixel of the mask; FAR_PX everywhere if it is empty."""
    if not mask.any():
        return np.full(mask.shape, FAR_PX, np.float32)
    return inward_px(~mask, 3)


def inward_px(mask: MaskArray, kernel: Literal[3, 5] = 5) -> Float32Array:
    """(H, W) distance to the nearest pixel beside the mask, 0 there. kernel: of OpenCV's approximation."""
    out = np.zeros(mask.shape, np.float32)
    window = window_around(mask, 1)
    out[window] = cv2.distanceTransform(mask[window].astype(np.uint8), cv2.DIST_L2, kernel)
    return out


def resized(mask: MaskArray, size: tuple[int, int]) -> MaskArray:
    """The mask's nearest pixels on a grid of this size, (width, height)."""
    return cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0


def components(mask: MaskArray) -> list[MaskArray]:
    """Return the mask's connected parts, each (H, W)."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8))
    return [labels == label for label in range(1, count)]


def solidity(mask: MaskArray) -> float:
    """Return the share of its convex hull that the mask fills; pixels' centres span the hull, so that it may pass 1."""
    hull = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32)) if mask.any() else None
    area = 0.0 if hull is None else float(cv2.contourArea(hull))
    return np.count_nonzero(mask) / area if area > 0 else 0.0
