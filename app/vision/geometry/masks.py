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
    """(H, W) number of each pixel's connected part, from 1 on; by number x, y, width, height, area; and the middles."""
    _, labels, stats, middles = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=connectivity
    )
    return (
        np.asarray(labels, np.int32),
        np.asarray(stats, np.int32),
        np.asarray(middles, np.float64),
    )


def without_specks(mask: MaskArray, least_px: float) -> MaskArray:
    """The mask's connected parts of at least this area, px."""
    labels, stats, _ = labelled(mask)
    kept = stats[:, cv2.CC_STAT_AREA] >= least_px
    kept[0] = False
    return kept[labels]


def opened(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask without what is narrower than a square of this side."""
    return (
        cv2.morphologyEx(
            mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((size_px, size_px), np.uint8)
        )
        > 0
    )


def closed(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask with its gaps that are narrower than a square of this side."""
    return (
        cv2.morphologyEx(
            mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((size_px, size_px), np.uint8)
        )
        > 0
    )


def dilated(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask grown by a square of this side."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((size_px, size_px), np.uint8)) > 0


def eroded(mask: MaskArray, size_px: int) -> MaskArray:
    """The mask shrunk by a square of this side."""
    return cv2.erode(mask.astype(np.uint8), np.ones((size_px, size_px), np.uint8)) > 0


def window_around(mask: MaskArray, margin_px: int) -> tuple[slice, slice]:
    """Rows and columns of a mask that is not empty, with a margin."""
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
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, kernel), np.float32)


def inward_in(mask: MaskArray, window: tuple[slice, slice]) -> Float32Array:
    """(H, W) inward_px of a mask that lies within the window of rows and columns, a pixel or more from its border."""
    out = np.zeros(mask.shape, np.float32)
    out[window] = inward_px(mask[window])
    return out


def components(mask: MaskArray) -> list[MaskArray]:
    """Return the mask's connected parts, each (H, W)."""
    labels, stats, _ = labelled(mask)
    return [labels == label for label in range(1, len(stats))]


def solidity(mask: MaskArray) -> float:
    """Return the share of its convex hull that the mask fills; pixels' centres span the hull, so that it may pass 1."""
    hull = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32)) if mask.any() else None
    area = 0.0 if hull is None else float(cv2.contourArea(hull))
    return np.count_nonzero(mask) / area if area > 0 else 0.0
