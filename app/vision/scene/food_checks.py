"""Whether what was cut out is food: large, solid, raised and whole; cutlery, a telephone, a rim and a wall are not."""

import cv2
import numpy as np

from app.vision.geometry.masks import eroded, inward_px, largest_part, solidity
from app.vision.geometry.pictures import lab_bytes
from app.vision.model import MaskArray
from app.vision.scene.scene import IS_TABLE, Scene

MIN_AREA_MM2 = 250.0  # seen from above the camera: smaller than a cherry tomato is clutter
MIN_SOLIDITY = 0.5  # a mask that fills less of its convex hull is a rim or an arc of it
MIN_CORE_MM2 = 40.0  # of a mask that geometry alone calls food
MIN_THICKNESS_MM = 10.0  # of a mask at its widest
MIN_TEXTURED_SHARE = 0.15  # of a mask
CUTLERY_ASPECT = 0.3  # width over length of knives, forks and spoons
MIRROR_MM, GREY_CHROMA = 25.0, 5.0  # height and chroma of a spoon's bowl
MIRROR_BLUR = 0.1  # of correlation, which a mirrored room costs
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

    Cutlery mirrors the room and a telephone shows its edges alone, so that their heights are some millimetres wrong;
    the bowl of a spoon, which is grey, by some more.
    """
    heights = scene.height_mm[mask]
    heights = heights[np.isfinite(heights)]
    top_mm = float(np.quantile(heights, 0.9)) if len(heights) else 0.0
    if not np.isfinite(scene.height_mm).any() and not _is_grey(mask, scene):
        return False  # a single view measures no height: what is long and coloured may be a banana
    if top_mm > MIRROR_MM or (top_mm > TABLE_THING_MM and not _is_grey(mask, scene)):
        return False
    _, sides, _ = cv2.minAreaRect(np.argwhere(mask)[:, ::-1].astype(np.float32))
    if top_mm <= TABLE_THING_MM and width_px < CUTLERY_ASPECT * max(sides):
        return True
    correlation = scene.table_correlation[mask]
    correlation = correlation[np.isfinite(correlation)]
    is_textured = len(correlation) > MIN_TEXTURED_SHARE * np.count_nonzero(mask)
    return bool(
        is_textured and np.median(correlation) > IS_TABLE - MIRROR_BLUR * (top_mm > TABLE_THING_MM)
    )


def _is_grey(mask: MaskArray, scene: Scene) -> bool:
    lab = lab_bytes(np.ascontiguousarray(scene.image_bgr[mask][None]))[0]
    return bool(np.median(np.hypot(lab[:, 1] - 128.0, lab[:, 2] - 128.0)) < GREY_CHROMA)
