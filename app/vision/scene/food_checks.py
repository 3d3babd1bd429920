"""Whether what was cut out is food: large, solid, raised and whole; cutlery, a telephone, a rim and a wall are not."""

import cv2
import numpy as np

from app.vision.geometry.masks import eroded, inward_px, largest_part, solidity
from app.vision.model import MaskArray
from app.vision.scene.scene import IS_TABLE, Scene

MIN_AREA_MM2 = 250.0  # seen from above the camera: smaller than a cherry tomato is clutter
MIN_SOLIDITY = 0.5  # a mask that fills less of its convex hull is a rim or an arc of it
MIN_CORE_MM2 = 40.0  # of a mask that geometry alone calls food
MIN_THICKNESS_MM = 10.0  # of a mask at its widest
MIN_TEXTURED_SHARE = 0.15  # of a mask
CUTLERY_ASPECT = 0.3  # width over length of knives, forks and spoons
TABLE_THING_MM = 14.0  # over the table, as which cutlery and a telephone are measured
# of its outline on the border of what is seen: the rest of it is unknown, or it is a wall
MAX_BORDER_SHARE = 0.15


def is_food(mask: MaskArray, is_core: MaskArray, scene: Scene, is_unseen: MaskArray) -> bool:
    """Return whether a mask is large, solid, raised and whole enough to be a food rather than a rim, a wall or clutter.

    All (h, w). is_unseen: beyond its border a mask may go on; where it ends at a vessel or another food it does not.
    """
    square_mm = scene.pixel_mm**2
    if (
        np.count_nonzero(mask) * square_mm < MIN_AREA_MM2
        or np.count_nonzero(mask & is_core) * square_mm < MIN_CORE_MM2
    ):
        return False
    depth = inward_px(mask)
    if (
        2 * float(depth.max()) * scene.pixel_mm < MIN_THICKNESS_MM
        or solidity(largest_part(mask)) < MIN_SOLIDITY
    ):
        return False
    if _is_table_thing(mask, 2 * float(depth.max()), scene):
        return False
    outline = mask & (depth <= 1.5)
    at_border = ~eroded(np.pad(~is_unseen[1:-1, 1:-1], 1), 5)
    return bool(
        np.count_nonzero(outline & at_border) <= MAX_BORDER_SHARE * np.count_nonzero(outline)
    )


def _is_table_thing(mask: MaskArray, width_px: float, scene: Scene) -> bool:
    """Whether a mask is low and either long as cutlery or no more than the table, on whose plane both views agree.

    Cutlery mirrors the room and a telephone shows its edges alone, so that their heights are some millimetres wrong.
    """
    if not np.isfinite(scene.height_mm).any():
        return False  # a single view measures no height: what is long may be a banana
    heights = scene.height_mm[mask]
    heights = heights[np.isfinite(heights)]
    if len(heights) and float(np.quantile(heights, 0.9)) > TABLE_THING_MM:
        return False
    _, sides, _ = cv2.minAreaRect(np.argwhere(mask)[:, ::-1].astype(np.float32))
    if width_px < CUTLERY_ASPECT * max(sides):
        return True
    correlation = scene.table_correlation[mask]
    correlation = correlation[np.isfinite(correlation)]
    is_textured = len(correlation) > MIN_TEXTURED_SHARE * np.count_nonzero(mask)
    return bool(is_textured and np.median(correlation) > IS_TABLE)
