"""Gaps in what is raised, through which the support shows: the hole of a ring, a space that foods enclose.

Raised parts with heights and colour's evidence -> the middle of each gap; a mask with heights -> its holes; of one
photograph, a mask and its picture -> the hole in its middle. A window of the disparity that is wider than a gap can
only fill it, never dig one: a low height in a gap counts whatever its window.
"""

import numpy as np

from app.vision.geometry.masks import (
    components,
    dilated,
    distance_px,
    filled,
    inward_px,
    labelled,
    opened,
)
from app.vision.geometry.pictures import blurred
from app.vision.model import Float32Array, ImageArray, MaskArray
from app.vision.scene.colour_bins import byte_bins, colour_evidence, colour_histogram, shaded_bins

MIN_GAP_MM2 = 60.0
LOW_SHARE = 0.5  # of the height around a gap, below which it is one and not a dent
# of colour for the food, above which a gap is food in shade, or gloss whose depth deceives
MAX_FOOD_NATS = 1.0
MIDDLE_SHARE = 0.5  # of a gap's greatest depth, from which it is certain; the rest is for the image's edges to tell
AROUND_PX = 4
MIN_POINTS = 5
LEAST_DEPTH_PX = 6.0  # of a food in which a hole is sought by colour
OUTER_SHARE = 0.5  # of that depth: a ring's food lies farther out than that, if anywhere
HOLE_DEPTH_SHARE = 0.25  # of that depth, within which a hole lies
SUPPORT_NATS = 0.5  # of colour for the support, above which it shows
HOLE_SHARE = 0.015  # of the food's outline, that a hole covers at least
OFF_MIDDLE = 0.3  # of a disc's radius as large as the food, by which a hole may lie off its middle


def find_gaps(
    is_raised: MaskArray, height_mm: Float32Array, colour_nats: Float32Array, pixel_mm: float
) -> MaskArray:
    """(H, W) the middle of each gap.

    height_mm: (H, W) over the support, NaN where unmeasured. colour_nats: (H, W) log likelihood of food over the rest.
    """
    gaps = np.zeros(is_raised.shape, np.bool_)
    labels, stats, _ = labelled(~is_raised, 4)
    for label in range(1, len(stats)):
        x, y, width, height, area = (int(value) for value in stats[label])
        is_open = (
            x == 0 or y == 0 or x + width == is_raised.shape[1] or y + height == is_raised.shape[0]
        )
        if is_open or area * pixel_mm**2 < MIN_GAP_MM2:
            continue
        window = (
            slice(max(0, y - AROUND_PX), y + height + AROUND_PX),
            slice(max(0, x - AROUND_PX), x + width + AROUND_PX),
        )
        part = labels[window] == label
        around = dilated(part, 2 * AROUND_PX + 1) & is_raised[window]
        low, high = (
            height_mm[window][where & np.isfinite(height_mm[window])] for where in (part, around)
        )
        if min(len(low), len(high)) < MIN_POINTS or np.median(low) >= LOW_SHARE * np.median(high):
            continue
        if np.median(colour_nats[window][part]) < MAX_FOOD_NATS:
            depth = inward_px(part, 3)
            gaps[window] |= depth > MIDDLE_SHARE * float(depth.max())
    return gaps


def open_holes(mask: MaskArray, height_mm: Float32Array, pixel_mm: float) -> MaskArray:
    """(H, W) the holes of a mask whose heights lie well below the food around them: a ring's, not gloss.

    In a food of which no height is measured all but small holes count: its colour alone shows them.
    """
    own = height_mm[mask]
    own = own[np.isfinite(own)]
    holes = np.zeros(mask.shape, np.bool_)
    for hole in components(filled(mask) & ~mask):
        low = height_mm[hole]
        low = low[np.isfinite(low)]
        area_mm2 = np.count_nonzero(hole) * pixel_mm**2
        if len(own) == 0 and area_mm2 > MIN_GAP_MM2:
            holes |= hole  # a single view knows it by its colour alone
            continue
        if area_mm2 < MIN_GAP_MM2 or min(len(low), len(own)) < MIN_POINTS:
            continue
        if float(np.quantile(low, 0.25)) < LOW_SHARE * float(np.median(own)):
            holes |= hole
    return holes


def hole_by_colour(mask: MaskArray, others: MaskArray, image_bgr: ImageArray) -> MaskArray:
    """(H, W) the hole in a food's middle through which its support shows; empty without one.

    others: (H, W) what lies beside the food and is no support. Without heights only a ring's hole is told from a spot.
    """
    whole = filled(mask)
    depth = inward_px(whole, 3)
    deepest = float(depth.max())
    hole = np.zeros(mask.shape, np.bool_)
    beside_px = distance_px(whole)
    support = (beside_px > 3) & (beside_px < max(8.0, OUTER_SHARE * deepest)) & ~others
    food = whole & (depth > 2) & (depth < OUTER_SHARE * deepest)
    if deepest < LEAST_DEPTH_PX or not support.any() or not food.any():
        return hole
    bins = byte_bins(image_bgr)
    of_food = colour_histogram([bins], food)
    of_support = colour_histogram([bins, *shaded_bins(image_bgr)], support)
    nats = blurred(colour_evidence(of_support, of_food)[bins], 1.5)
    labels, stats, middles = labelled(
        opened((nats > SUPPORT_NATS) & (depth > HOLE_DEPTH_SHARE * deepest), 3)
    )
    area = float(np.count_nonzero(whole))
    middle = np.argwhere(whole).mean(axis=0)[::-1]
    off_middle = np.linalg.norm(middles - middle, axis=1) / np.sqrt(area / np.pi)
    of_ring = (stats[:, 4] > HOLE_SHARE * area) & (off_middle < OFF_MIDDLE)
    of_ring[0] = False
    return np.asarray(of_ring[labels], np.bool_)
