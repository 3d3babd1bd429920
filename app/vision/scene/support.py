"""How high the surface lies that a food rests on, and how surely: table, board's top, plate's floor, bowl's inside.

Points of the rectified view, the dish, a food's mask -> height over the marker's plane and standard deviation, mm.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from app.vision.geometry.masks import distance_px, inward_px
from app.vision.geometry.topview import TableTrend, TopView
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.dish import Dish
from app.vision.scene.scene import FINE_REACH_PX, Scene
from app.vision.tuning import FLOOR_TUNING

# from the mask's outline: beyond what a food's height spreads over plain surroundings
RING_PX = (18.0, 60.0)
# what a support may measure; other points belong to other foods or are strays
RANGE_MM = (-4.0, 20.0)
QUANTILE = 0.3  # of the ring's heights: rims and neighbours lie higher, nothing lies lower
MIN_POINTS = 100

NEAR_MM = (4.0, 60.0)  # from the food's outline, where the table is looked for
LEVEL_STEP_MM = 4.0  # from where it should be; what lies farther is no table
TABLE_SD_MM = 0.5  # of a table about its trend: unevenness, and what the poses leave
LEVEL_SD_MM = 0.4  # that measuring leaves beside the heights' spread
FLOOR_INWARD_MM = 35.0  # from the dish's outline, where a plate is flat
FLOOR_CLEAR_MM = 5.0  # from any food
FLOOR_LEAST_MM = -3.0
FLOOR_SD_MM = 1.2  # as LEVEL_SD_MM: a plain glossy floor mirrors what stands on it
LOW_QUANTILE = 0.35  # of the heights: windows that lie across what stands on a support lift it, nothing lowers it
PIXELS_PER_FACT = 50.0  # neighbouring heights come of overlapping windows and err alike
SHARED_SHARE = 0.5  # of the spread of heights that no number of them averages away
# mean and spread of a bowl's inside, shares of its rim's height; its food hides it
BOWL_PRIOR = (0.125, 0.07)

# Where nothing is measured: a plate's rim lies 10 to 25 mm over the table and its floor, over its foot ring, 2 to 7 mm;
# a board is 10 to 25 mm thick.
TYPICAL_RIM_MM = 15.0
FLOOR_UNDER_RIM_MM, TYPICAL_FLOOR_SD_MM = 11.0, 2.0
TYPICAL_BOARD_MM, TYPICAL_BOARD_SD_MM = 16.0, 5.0
# of how far a rim is from where it should be: what the plane is then is less sure
PLANE_DOUBT = 0.3
RIM_WIDTH_MM = 15.0
# around a food, where a depth map shows its support
DEPTH_RING_MM, DEPTH_STEP_MM = (8.0, 35.0), 25.0
DEPTH_LEVEL_SD_MM = 1.0
TYPICAL_TABLE_SD_MM = 1.0  # of a table that only the sheet shows


@dataclass(frozen=True, slots=True)
class Support:
    """What a food rests on.

    height_mm: over the marker's plane
    sd_mm: its standard deviation
    source: "table" is measured around the food, "board" within its rim; "floor" is a plate's, measured as far as it
        can be and otherwise guessed from the rim; "bowl" is guessed, since the food hides it
    """

    height_mm: float
    sd_mm: float
    source: Literal["table", "board", "floor", "bowl"]


def find_support(
    scene: Scene,
    view: TopView,
    dish: Dish | None,
    trend: TableTrend,
    mask: MaskArray,
    foods: MaskArray,
) -> Support:
    """The support of one food. mask, foods: (h, w) this food and all foods, on the scene's grid."""
    inside = mask & np.isfinite(scene.points_table[..., 2])
    middle = np.median(
        scene.points_table[inside][:, :2] if inside.any() else scene.plane_xy_mm[mask], axis=0
    )
    table_mm = float(trend.height_mm(middle))
    if not np.isfinite(scene.height_mm).any():
        return _typical_support(dish, table_mm)
    if dish is not None and dish.floor_mm > 0:
        sd = float(np.hypot(dish.floor_sd_mm, LEVEL_SD_MM))
        return Support(table_mm + dish.floor_mm, sd, "board")
    clear_mm = scene.pixel_mm * distance_px(foods)
    if dish is not None and dish.is_deep:
        return Support(table_mm + BOWL_PRIOR[0] * dish.rim_mm, BOWL_PRIOR[1] * dish.rim_mm, "bowl")
    heights = np.nan_to_num(scene.height_mm, nan=np.inf)
    if dish is not None:
        inward = dish.inward_at(view, scene.points_table[..., :2])
        is_floor = (heights > FLOOR_LEAST_MM) & (heights < dish.rim_mm)
        is_floor &= (inward > FLOOR_INWARD_MM) & (clear_mm > FLOOR_CLEAR_MM)
        prior_mm, prior_sd = (share * dish.rim_mm for share in FLOOR_TUNING.plate_of_rim)
        floor_mm, sd = _reconciled(heights[is_floor], prior_mm, prior_sd, FLOOR_SD_MM)
        return Support(table_mm + max(0.0, floor_mm), sd, "floor")
    own_mm = scene.pixel_mm * distance_px(mask)
    is_near = ~scene.is_ignored & (np.abs(heights) < LEVEL_STEP_MM) & (own_mm < NEAR_MM[1])
    is_near &= (clear_mm > NEAR_MM[0]) & (scene.reach_px < FINE_REACH_PX)
    level_mm, sd = _reconciled(heights[is_near], 0.0, TABLE_SD_MM, LEVEL_SD_MM)
    return Support(table_mm + level_mm, sd, "table")


def measured_support(
    usual: Support, scene: Scene, trend: TableTrend, mask: MaskArray, foods: MaskArray
) -> Support:
    """The usual support, corrected by heights around the food (h, w), which are noisy but many."""
    clear_mm, own_mm = scene.pixel_mm * distance_px(foods), scene.pixel_mm * distance_px(mask)
    table_mm = float(np.nanmedian(trend.height_mm(scene.plane_xy_mm[mask])))
    expected_mm = usual.height_mm - table_mm
    is_near = (own_mm < DEPTH_RING_MM[1]) & (clear_mm > DEPTH_RING_MM[0]) & ~scene.is_ignored
    heights = scene.height_mm[
        is_near & (np.abs(scene.height_mm - np.float32(expected_mm)) < DEPTH_STEP_MM)
    ]
    level_mm, sd_mm = _reconciled(heights, expected_mm, usual.sd_mm, DEPTH_LEVEL_SD_MM, 0.5)
    return Support(table_mm + level_mm, max(sd_mm, TABLE_SD_MM), usual.source)


def with_measured_rim(dish: Dish, view: TopView, scene: Scene) -> Dish | None:
    """Return the dish, whose outline is known by its colour, with its rim as high as it is measured; None if it is not.

    A plain table is no plane that can be found: the plane under such a scene is often the rim's own.
    """
    inward = dish.inward_at(view, scene.xy_at(dish.rim_mm))
    heights = scene.height_mm[
        (inward > 0.0) & (inward < RIM_WIDTH_MM) & np.isfinite(scene.height_mm)
    ]
    if len(heights) < MIN_POINTS:
        return None
    rim_mm = float(np.median(heights))
    return replace(dish, rim_mm=rim_mm, floor_mm=rim_mm if dish.floor_mm > 0 else 0.0)


def _typical_support(dish: Dish | None, table_mm: float) -> Support:
    """Typical heights of dishes, for views without measured heights."""
    if dish is None:
        return Support(table_mm, TYPICAL_TABLE_SD_MM, "table")
    if dish.floor_mm > 0:
        return Support(table_mm + dish.rim_mm, TYPICAL_BOARD_SD_MM, "board")
    doubt_mm = PLANE_DOUBT * abs(dish.rim_mm - TYPICAL_RIM_MM)
    return Support(
        table_mm + dish.rim_mm - FLOOR_UNDER_RIM_MM,
        float(np.hypot(TYPICAL_FLOOR_SD_MM, doubt_mm)),
        "floor",
    )


def _reconciled(
    heights_mm: Float32Array,
    expected_mm: float,
    expected_sd: float,
    least_sd: float,
    quantile: float = LOW_QUANTILE,
) -> tuple[float, float]:
    """Level and its sd, mm, of what was expected and what was measured. heights_mm: (n,). least_sd: of measuring."""
    if len(heights_mm) < MIN_POINTS:
        return expected_mm, expected_sd
    measured_mm = float(np.quantile(heights_mm, quantile))
    spread = 1.48 * float(np.median(np.abs(heights_mm - np.median(heights_mm))))
    variance = spread**2 * (PIXELS_PER_FACT / len(heights_mm) + SHARED_SHARE**2) + least_sd**2
    weight = expected_sd**2 / (expected_sd**2 + variance)
    return weight * measured_mm + (1.0 - weight) * expected_mm, float(np.sqrt(weight * variance))


def support_height_mm(
    points_table: Float32Array, mask: MaskArray, others: MaskArray
) -> float | None:
    """Height of the support around a food, mm, at least 0; None where too little of it was measured.

    points_table: (H, W, 3) mm, NaN. mask: (H, W) the food. others: (H, W) other foods, the sheet, what is not seen.
    """
    distance = inward_px(~mask)
    heights = points_table[..., 2][(distance > RING_PX[0]) & (distance < RING_PX[1]) & ~others]
    heights = heights[(heights > RANGE_MM[0]) & (heights < RANGE_MM[1])]
    if len(heights) < MIN_POINTS:
        return None
    return max(0.0, float(np.quantile(heights, QUANTILE)))
