"""How high the surface lies that a food rests on, and how surely: table, board's top, plate's floor, bowl's inside.

Points of the rectified view, the dish, a food's mask -> height over the marker's plane and standard deviation, mm.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from app.vision.dish import Dish
from app.vision.food_pixels import FINE_REACH_PX, Scene
from app.vision.model import Float32Array, MaskArray
from app.vision.topview import TableTrend, TopView

RING_PX = (18.0, 60.0)  # from the mask's outline: beyond what a food's height spreads over plain surroundings
RANGE_MM = (-4.0, 20.0)  # what a support may measure; other points belong to other foods or are strays
QUANTILE = 0.3  # of the ring's heights: rims and neighbours lie higher, nothing lies lower
MIN_POINTS = 100

NEAR_TABLE_MM = (4.0, 60.0)  # from the food's outline, where the table under it is looked for
TABLE_STEP_MM = 4.0  # from the trend: what lies farther is no table
TABLE_SD_MM = 0.4  # of a table's trend: unevenness, and what the poses leave
TREND_SD_MM = 1.2  # where no table is measured near the food
FLOOR_INWARD_MM = 35.0  # from the dish's outline, where a plate is flat
FLOOR_CLEAR_MM = 5.0  # from any food
FLOOR_LEAST_MM = -3.0
PIXELS_PER_FACT = 50.0  # neighbouring heights come of overlapping windows and err alike
SHARED_SHARE = 0.5  # of the spread of a floor's heights that no number of them averages away
FLOOR_PRIOR = (
    0.3,
    0.17,
)  # mean and spread of a plate's floor, as shares of its rim's height: anywhere in the lower half
BOWL_PRIOR = (0.125, 0.07)  # the same of a bowl's inside, which its food hides


@dataclass(frozen=True, slots=True)
class Support:
    """height_mm over the marker's plane, sd_mm its standard deviation.

    source: "table" and "board" are measured around the food; "floor" is a plate's, measured as far as it can be and
    otherwise guessed from the rim; "bowl" is guessed: the food hides it.
    """

    height_mm: float
    sd_mm: float
    source: Literal["table", "board", "floor", "bowl"]


def find_support(
    scene: Scene, view: TopView, dish: Dish | None, trend: TableTrend, mask: MaskArray, foods: MaskArray
) -> Support:
    """The support of one food. mask, foods: (h, w) this food and all foods, on the scene's grid."""
    inside = mask & np.isfinite(scene.points_table[..., 2])
    middle = np.median(scene.points_table[inside][:, :2] if inside.any() else scene.plane_xy_mm[mask], axis=0)
    table_mm = float(trend.height_mm(middle))
    clear_mm = scene.pixel_mm * cv2.distanceTransform((~foods).astype(np.uint8), cv2.DIST_L2, 3)
    is_fine = (scene.reach_px < FINE_REACH_PX) & np.isfinite(scene.height_mm) & ~scene.is_ignored
    flat_mm = 0.0 if dish is None else dish.floor_mm
    if dish is None or (flat_mm > 0 and not dish.is_deep):
        own_mm = scene.pixel_mm * cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
        near = is_fine & (own_mm < NEAR_TABLE_MM[1]) & (clear_mm > NEAR_TABLE_MM[0])
        heights = scene.height_mm[near]
        heights = heights[np.abs(heights - flat_mm) < TABLE_STEP_MM]
        source: Literal["table", "board"] = "table" if dish is None else "board"
        if len(heights) < MIN_POINTS:
            return Support(table_mm + flat_mm, TREND_SD_MM, source)
        return Support(table_mm + float(np.median(heights)), TABLE_SD_MM, source)
    if dish.is_deep:
        return Support(table_mm + BOWL_PRIOR[0] * dish.rim_mm, BOWL_PRIOR[1] * dish.rim_mm, "bowl")
    inward = dish.inward_at(view, scene.points_table[..., :2])
    with np.errstate(invalid="ignore"):
        in_range = (scene.height_mm > FLOOR_LEAST_MM) & (scene.height_mm < dish.rim_mm)
    is_floor = np.isfinite(scene.height_mm) & in_range & (inward > FLOOR_INWARD_MM) & (clear_mm > FLOOR_CLEAR_MM)
    prior_mm, prior_sd = (share * dish.rim_mm for share in FLOOR_PRIOR)
    heights = scene.height_mm[is_floor]
    if len(heights) < MIN_POINTS:
        return Support(table_mm + prior_mm, prior_sd, "floor")
    measured_mm = float(np.median(heights))
    spread = 1.48 * float(np.median(np.abs(heights - measured_mm)))
    variance = spread**2 * (PIXELS_PER_FACT / len(heights) + SHARED_SHARE**2) + TREND_SD_MM**2
    weight = prior_sd**2 / (prior_sd**2 + variance)
    floor_mm = weight * measured_mm + (1.0 - weight) * prior_mm
    return Support(table_mm + max(0.0, floor_mm), float(np.sqrt(weight * variance)), "floor")


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
