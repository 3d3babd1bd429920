"""One food cut out of a photograph for the Visual Characterization Metrics: its pixels and its mask at a fixed size.

Polygon or box in the photograph -> Region. All features are taken at this size, so that they say little of how far the
camera was. Only what is given of the food by a box is told from what lies around it here: by GrabCut (Rother,
Kolmogorov and Blake, 2004), with what lies outside the box as the background.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.model import Float64Array, ImageArray, MaskArray

SIDE_PX = 160  # of a region's longer side: the grain of bread and the pores of an orange are still there
MARGIN = 0.25  # of the region's sides, on each side: what lies around it
CUT_SIDE_PX = 80  # of a box while the food in it is told from its background, which takes time
CUT_ROUNDS = 4
LEAST_COVER = 0.25  # of its box: less is a highlight or a shadow, and the food was not found
CLOSING_PX = 5
SEED = 1  # of the clusters that GrabCut begins with

Box = tuple[float, float, float, float]  # x, y, width, height, px


@dataclass(frozen=True, slots=True)
class Region:
    """pixels_bgr: (h, w, 3); mask: (h, w), True on the food; the food's box has a longer side of SIDE_PX."""

    pixels_bgr: ImageArray
    mask: MaskArray


def region_of_rings(pixels_bgr: ImageArray, rings: Sequence[Float64Array]) -> Region | None:
    """The region within outlines, px (outer rings and holes, even-odd rule); None where nothing of it is in view."""
    corners = np.concatenate([np.asarray(ring, np.float64).reshape(-1, 2) for ring in rings])
    low, high = corners.min(axis=0), corners.max(axis=0)
    cut = _crop(pixels_bgr, (low[0], low[1], high[0] - low[0], high[1] - low[1]), SIDE_PX)
    if cut is None:
        return None
    crop, origin, scale = cut
    mask = np.zeros(crop.shape[:2], np.uint8)
    moved = [np.round((np.asarray(ring).reshape(-1, 2) - origin) * scale * 16).astype(np.int32) for ring in rings]
    cv2.fillPoly(mask, moved, 1, shift=4)
    return Region(crop, mask > 0) if mask.any() else None


def region_of_box(pixels_bgr: ImageArray, box: Box) -> Region | None:
    """The food in a box, px; None where the box is empty or outside the photograph."""
    cut = _crop(pixels_bgr, box, SIDE_PX)
    if cut is None:
        return None
    crop, origin, scale = cut
    inner = _inner_box(crop, origin, scale, box)
    mask = _food_in_box(crop, inner)
    return Region(crop, mask)


def _crop(pixels_bgr: ImageArray, box: Box, side_px: int) -> tuple[ImageArray, Float64Array, float] | None:
    """The box and its margin, resized; its top left corner in the photograph, px; and the scale."""
    height, width = pixels_bgr.shape[:2]
    x, y, across, down = box
    if not (across >= 1.0 and down >= 1.0 and x < width and y < height and x + across > 0.0 and y + down > 0.0):
        return None
    left, right = max(0.0, x - MARGIN * across), min(float(width), x + (1.0 + MARGIN) * across)
    top, bottom = max(0.0, y - MARGIN * down), min(float(height), y + (1.0 + MARGIN) * down)
    x0, y0, x1, y1 = int(left), int(top), int(np.ceil(right)), int(np.ceil(bottom))
    scale = side_px / max(min(x + across, width) - max(x, 0.0), min(y + down, height) - max(y, 0.0))
    size = (max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale)))
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    crop = np.asarray(cv2.resize(pixels_bgr[y0:y1, x0:x1], size, interpolation=way), np.uint8)
    return crop, np.array([x0, y0], np.float64), scale


def _inner_box(crop: ImageArray, origin: Float64Array, scale: float, box: Box) -> tuple[int, int, int, int]:
    """The box in the crop: left, top, right, bottom, px; at least one pixel."""
    height, width = crop.shape[:2]
    left, top = (np.array(box[:2]) - origin) * scale
    right, bottom = (np.array(box[:2]) + np.array(box[2:]) - origin) * scale
    x0, y0 = int(np.clip(round(left), 0, width - 1)), int(np.clip(round(top), 0, height - 1))
    return x0, y0, int(np.clip(round(right), x0 + 1, width)), int(np.clip(round(bottom), y0 + 1, height))


def _food_in_box(crop: ImageArray, inner: tuple[int, int, int, int]) -> MaskArray:
    """(h, w): the largest piece in the box that differs from what is around it; an ellipse where none stands out."""
    height, width = crop.shape[:2]
    scale = min(1.0, CUT_SIDE_PX / SIDE_PX)
    small = cv2.resize(
        crop, (max(1, round(width * scale)), max(1, round(height * scale))), interpolation=cv2.INTER_AREA
    )
    x0, y0, x1, y1 = (round(each * scale) for each in inner)
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
        middle, half = ((x0 + x1) // 2, (y0 + y1) // 2), (max(1, (x1 - x0) // 2), max(1, (y1 - y0) // 2))
        cv2.ellipse(mask, middle, half, 0.0, 0.0, 360.0, 1, -1)
    kernel = np.ones((CLOSING_PX, CLOSING_PX), np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel) > 0)


def _largest_piece(mask: ImageArray) -> ImageArray:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return np.asarray(labels == largest, np.uint8)
