"""How much two outlines cover each other: the area that both enclose over the area that either encloses (IoU)."""

from collections.abc import Sequence

import cv2
import numpy as np
import scipy

from app.vision.model import Float64Array, MaskArray

LONGEST_PX = 512  # of the raster: an outline of a tenth of the photograph's width still covers some 2,000 pixels
SUBPIXEL_BITS = 8
TIE = 1e-6  # far below what one pixel of the raster changes

Rings = Sequence[Sequence[Sequence[float]]]  # corners [x, y], px; holes by the even-odd rule


def overlaps(first: Sequence[Rings], second: Sequence[Rings]) -> Float64Array:
    """(n, m): IoU of each outline of `first` with each of `second`, 0 to 1; an outline without area overlaps nothing.

    Equal outlines have exactly 1. Rasterised, so outlines that differ by less than the raster's pixel may have 1 too.
    """
    corners = [
        np.asarray(ring, np.float64)
        for outline in (*first, *second)
        for ring in outline
        if len(ring)
    ]
    if not corners:
        return np.zeros((len(first), len(second)))
    low, high = np.vstack(corners).min(axis=0), np.vstack(corners).max(axis=0)
    scale = (LONGEST_PX - 1) / max(float((high - low).max()), 1.0)
    masks = [_mask(outline, low, scale) for outline in (*first, *second)]
    return np.array(
        [[_iou(one, other) for other in masks[len(first) :]] for one in masks[: len(first)]],
        np.float64,
    ).reshape(len(first), len(second))


def matching_outlines(
    first: Sequence[Rings], second: Sequence[Rings], *, above: float
) -> list[tuple[int, int]]:
    """Match outlines one to one so that the sum of their IoU is greatest; pairs up to `above` are left out.

    Returns (place in first, place in second), in the order of first. Of equally good matches, equal places win.
    """
    iou = overlaps(first, second)
    preferred = np.where(iou > above, iou + TIE * np.eye(*iou.shape), 0.0)
    pairs = zip(*scipy.optimize.linear_sum_assignment(preferred, maximize=True), strict=True)
    return [(int(row), int(column)) for row, column in pairs if iou[row, column] > above]


def _mask(outline: Rings, low: Float64Array, scale: float) -> MaskArray:
    mask = np.zeros((LONGEST_PX, LONGEST_PX), np.uint8)
    rings = [(np.asarray(ring, np.float64) - low) * scale for ring in outline if len(ring) >= 3]
    fixed = [np.rint(ring * 2**SUBPIXEL_BITS).astype(np.int32) for ring in rings]
    if fixed:
        cv2.fillPoly(mask, fixed, 1, shift=SUBPIXEL_BITS)
    return mask.astype(bool)


def _iou(one: MaskArray, other: MaskArray) -> float:
    either = np.count_nonzero(one | other)
    return np.count_nonzero(one & other) / either if either else 0.0
