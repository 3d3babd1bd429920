"""How high the support lies under a food: plate, bread board or table, from the points around it.

Points of the rectified view and a food's mask -> height over the marker's plane, mm.
"""

import cv2
import numpy as np

from app.vision.model import Float32Array, MaskArray

RING_PX = (18.0, 60.0)  # from the mask's outline: beyond what a food's height spreads over plain surroundings
RANGE_MM = (-4.0, 20.0)  # what a support may measure; other points belong to other foods or are strays
QUANTILE = 0.3  # of the ring's heights: rims and neighbours lie higher, nothing lies lower
MIN_POINTS = 100


def support_height_mm(points_table: Float32Array, mask: MaskArray, others: MaskArray) -> float | None:
    """Height of the support around a food, mm, at least 0; None where too little of it was measured.

    points_table: (H, W, 3) mm, NaN. mask: (H, W) the food. others: (H, W) other foods, the sheet, what is not seen.
    """
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    heights = points_table[..., 2][(distance > RING_PX[0]) & (distance < RING_PX[1]) & ~others]
    heights = heights[(heights > RANGE_MM[0]) & (heights < RANGE_MM[1])]
    if len(heights) < MIN_POINTS:
        return None
    return max(0.0, float(np.quantile(heights, QUANTILE)))
