"""Through which gaps in what is raised the support shows: the hole of a ring, a space that foods enclose.

Raised parts with heights and colour's evidence -> the middle of each gap. A window of the disparity that is wider than
a gap can only fill it, never dig one: a low height in a gap counts whatever its window.
"""

import numpy as np

from app.vision.geometry.masks import dilated, inward_px, labelled
from app.vision.model import Float32Array, MaskArray

MIN_GAP_MM2 = 60.0
LOW_SHARE = 0.5  # of the height around a gap, below which it is one and not a dent
MAX_FOOD_NATS = 1.0  # of colour for the food, above which a gap is food in shade, or gloss whose depth deceives
MIDDLE_SHARE = 0.5  # of a gap's greatest depth, from which it is certain; the rest is for the image's edges to tell
AROUND_PX = 4
MIN_POINTS = 5


def find_gaps(is_raised: MaskArray, height_mm: Float32Array, colour_nats: Float32Array, pixel_mm: float) -> MaskArray:
    """(H, W) the middle of each gap.

    height_mm: (H, W) over the support, NaN where unmeasured. colour_nats: (H, W) log likelihood of food over the rest.
    """
    gaps = np.zeros(is_raised.shape, np.bool_)
    labels, stats, _ = labelled(~is_raised, 4)
    for label in range(1, len(stats)):
        x, y, width, height, area = (int(value) for value in stats[label])
        is_open = x == 0 or y == 0 or x + width == is_raised.shape[1] or y + height == is_raised.shape[0]
        if is_open or area * pixel_mm**2 < MIN_GAP_MM2:
            continue
        window = (
            slice(max(0, y - AROUND_PX), y + height + AROUND_PX),
            slice(max(0, x - AROUND_PX), x + width + AROUND_PX),
        )
        part = labels[window] == label
        around = dilated(part, 2 * AROUND_PX + 1) & is_raised[window]
        low, high = (height_mm[window][where & np.isfinite(height_mm[window])] for where in (part, around))
        if min(len(low), len(high)) < MIN_POINTS or np.median(low) >= LOW_SHARE * np.median(high):
            continue
        if np.median(colour_nats[window][part]) < MAX_FOOD_NATS:
            depth = inward_px(part, 3)
            gaps[window] |= depth > MIDDLE_SHARE * float(depth.max())
    return gaps
