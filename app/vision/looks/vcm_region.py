"""One food cut out of a photograph for the Visual Characterization Metrics: its pixels and its mask at a fixed size.

Polygon or box in the photograph -> Region. All features are taken at this size, so that they say little of how far the
camera was. Only what is given of the food by a box is told from what lies around it here: by GrabCut (Rother,
Kolmogorov and Blake, "GrabCut: interactive foreground extraction using iterated graph cuts", ACM Trans. Graph. 23(3),
2004), with what lies outside the box as the background. What lies outside the photograph counts for nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.model import Float64Array, ImageArray, MaskArray

# of a region's longer side: the grain of bread and the pores of an orange are still there
SIDE_PX = 128
MARGIN = 0.25  # of the region's sides, on each side: what lies around it
CUT_SIDE_PX = 64  # of a box while the food in it is told from its background, which takes time
CUT_ROUNDS = 2  # more of them tell foods apart no better, and take half the time of naming one
LEAST_COVER = 0.25  # of its box: less is a highlight or a shadow, and the food was not found
CLOSING_PX = 5
EDGE = 0.05  # of each side of a photograph that a food fills: what lies there may be background
SEED = 1  # of the clusters that GrabCut begins with
LEAST_CORNERS = 3
LEAST_VIEW_PX = 1.0  # of a region, across and down, in the photograph: less is nothing to look at
# of a corner, at the region's size: rows beyond it are drawn one by one, for nothing
FARTHEST_PX = 2.0**18
SUBPIXEL_BITS = 4

Box = tuple[float, float, float, float]  # x, y, width, height, px
Edges = tuple[float, float, float, float]  # left, top, right, bottom, px


@dataclass(frozen=True, slots=True)
class Region:
    """pixels_bgr: (h, w, 3); mask: (h, w), True on the food; the longer side of its box in view is SIDE_PX."""

    pixels_bgr: ImageArray
    mask: MaskArray


def region_of_rings(pixels_bgr: ImageArray, rings: Sequence[Float64Array]) -> Region | None:
    """The region within outlines, px: (n, 2) each, outer rings and holes, even-odd rule.

    Rings of fewer than three corners bound nothing. None where nothing of it is in view, or a corner is not finite.
    Raises ValueError if pixels_bgr is not (H, W, 3) uint8.
    """
    outlines = [ring.reshape(-1, 2) for ring in rings]
    outlines = [outline for outline in outlines if len(outline) >= LEAST_CORNERS]
    if not outlines:
        return None
    corners = np.concatenate(outlines)
    if not np.isfinite(corners).all():
        return None
    low, high = corners.min(axis=0), corners.max(axis=0)
    cut = _crop(pixels_bgr, (float(low[0]), float(low[1]), float(high[0]), float(high[1])))
    if cut is None:
        return None
    crop, origin, scale = cut
    mask = np.zeros(crop.shape[:2], np.uint8)
    farthest = FARTHEST_PX / scale
    moved = [np.clip(outline - origin, -farthest, farthest) * scale for outline in outlines]
    fixed = [np.round(outline * 2**SUBPIXEL_BITS).astype(np.int32) for outline in moved]
    cv2.fillPoly(mask, fixed, 1, shift=SUBPIXEL_BITS)
    return Region(crop, mask > 0) if mask.any() else None


def region_of_box(pixels_bgr: ImageArray, box: Box) -> Region | None:
    """The food in a box, px; None where the box is empty, not finite, or outside the photograph.

    Raises ValueError if pixels_bgr is not (H, W, 3) uint8.
    """
    x, y, across, down = (float(side) for side in box)
    if not all(math.isfinite(each) for each in (x, y, across, down)):
        return None
    edges = (x, y, x + across, y + down)
    cut = _crop(pixels_bgr, edges)
    if cut is None:
        return None
    crop, origin, scale = cut
    return Region(crop, _food_in_box(crop, _inner_box(crop, origin, scale, edges)))


def regions_of_whole(pixels_bgr: ImageArray) -> tuple[Region, ...]:
    """A food that fills its photograph: all of it, and what stands out from the photograph's edge.

    Neither is the food alone, and which is nearer to it differs. Raises ValueError as region_of_box.
    """
    height, width = pixels_bgr.shape[:2]
    across, down = EDGE * width, EDGE * height
    inner = region_of_box(pixels_bgr, (across, down, width - 2 * across, height - 2 * down))
    cut = _crop(pixels_bgr, (0.0, 0.0, float(width), float(height)))
    if inner is None or cut is None:
        raise ValueError("the photograph is empty")
    return Region(cut[0], np.ones(cut[0].shape[:2], np.bool_)), inner


def _crop(pixels_bgr: ImageArray, edges: Edges) -> tuple[ImageArray, Float64Array, float] | None:
    """What is in view within edges, with a margin, resized; its top left corner in the photograph, px; the scale."""
    if pixels_bgr.ndim != 3 or pixels_bgr.shape[2] != 3 or pixels_bgr.dtype != np.uint8:
        raise ValueError(
            f"a photograph is (H, W, 3) uint8, not {pixels_bgr.shape} {pixels_bgr.dtype}"
        )
    height, width = pixels_bgr.shape[:2]
    # clipped before the margin: else a sliver in view would be enlarged together with the margin of what is not
    left, top = max(0.0, edges[0]), max(0.0, edges[1])
    right, bottom = min(float(width), edges[2]), min(float(height), edges[3])
    across, down = right - left, bottom - top
    if not (across >= LEAST_VIEW_PX and down >= LEAST_VIEW_PX):
        return None
    x0, x1 = (
        int(max(0.0, left - MARGIN * across)),
        math.ceil(min(float(width), right + MARGIN * across)),
    )
    y0, y1 = (
        int(max(0.0, top - MARGIN * down)),
        math.ceil(min(float(height), bottom + MARGIN * down)),
    )
    scale = SIDE_PX / max(across, down)
    size = (max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale)))
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    crop = np.asarray(cv2.resize(pixels_bgr[y0:y1, x0:x1], size, interpolation=way), np.uint8)
    return crop, np.array([x0, y0], np.float64), scale


def _inner_box(
    crop: ImageArray, origin: Float64Array, scale: float, edges: Edges
) -> tuple[int, int, int, int]:
    """What is within edges in the crop: left, top, right, bottom, px; at least one pixel."""
    height, width = crop.shape[:2]
    left, top = (edges[0] - float(origin[0])) * scale, (edges[1] - float(origin[1])) * scale
    right, bottom = (edges[2] - float(origin[0])) * scale, (edges[3] - float(origin[1])) * scale
    x0, y0 = round(min(max(left, 0.0), width - 1.0)), round(min(max(top, 0.0), height - 1.0))
    return (
        x0,
        y0,
        max(x0 + 1, round(min(right, float(width)))),
        max(y0 + 1, round(min(bottom, float(height)))),
    )


def _food_in_box(crop: ImageArray, inner: tuple[int, int, int, int]) -> MaskArray:
    """(h, w): the largest piece in the box that differs from what is around it; an ellipse where none stands out."""
    height, width = crop.shape[:2]
    scale = min(1.0, CUT_SIDE_PX / SIDE_PX)
    small = cv2.resize(
        crop,
        (max(1, round(width * scale)), max(1, round(height * scale))),
        interpolation=cv2.INTER_AREA,
    )
    x0, y0, x1, y1 = (round(each * scale) for each in inner)
    x0, y0 = min(x0, small.shape[1] - 1), min(y0, small.shape[0] - 1)
    labels = np.full(small.shape[:2], cv2.GC_BGD, np.uint8)
    labels[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)] = cv2.GC_PR_FGD
    if np.any(labels == cv2.GC_BGD):
        cv2.setRNGSeed(SEED)
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(small, labels, (0, 0, 1, 1), *models, CUT_ROUNDS, cv2.GC_INIT_WITH_MASK)
    food = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    smooth = cv2.resize(food * 255, (width, height), interpolation=cv2.INTER_LINEAR)
    mask = _largest_piece((smooth > 127).astype(np.uint8))
    x0, y0, x1, y1 = inner
    if mask[y0:y1, x0:x1].mean() < LEAST_COVER:
        mask[:] = 0
        middle, half = (
            ((x0 + x1) // 2, (y0 + y1) // 2),
            (max(1, (x1 - x0) // 2), max(1, (y1 - y0) // 2)),
        )
        cv2.ellipse(mask, middle, half, 0.0, 0.0, 360.0, 1, -1)
    kernel = np.ones((CLOSING_PX, CLOSING_PX), np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel) > 0)


def _largest_piece(mask: ImageArray) -> ImageArray:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return np.asarray(labels == largest, np.uint8)
