"""What an item is known again by in another pair of the same meal: where it stands, how large it is, its colour.

Region and points on the rectified grid -> ItemTraits. Colours are corrected by the marker, so that another light or the
phone's white balance changes them little. What belongs together is for leftovers.py.
"""

import numpy as np

from app.vision.board.colour_correction import apply_colour
from app.vision.board.colour_space import lab_of, linear_rgb
from app.vision.geometry.masks import eroded
from app.vision.model import ColourCorrection, Float32Array, ImageArray, ItemTraits, MaskArray

OUTLINE_PX = 2  # of a region is mixed with what lies behind it
MIN_PIXELS = 20


def traits_of(
    mask: MaskArray, points_table: Float32Array, pixels_bgr: ImageArray, colour: ColourCorrection
) -> ItemTraits:
    """An item's traits. mask: (H, W); points_table: (H, W, 3) mm, NaN; pixels_bgr: (H, W, 3) as taken."""
    points = points_table[mask][:, :2]
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    centre_mm, radius_mm = None, None
    if len(points) >= MIN_PIXELS:
        middle = np.median(points, axis=0)
        centre_mm = (float(middle[0]), float(middle[1]))
        # half a disc's area
        radius_mm = float(np.sqrt(2.0 * np.median(np.sum((points - middle) ** 2, axis=1))))
    return ItemTraits(centre_mm, radius_mm, _lab(mask, pixels_bgr, colour))


def _lab(
    mask: MaskArray, pixels_bgr: ImageArray, colour: ColourCorrection
) -> tuple[float, float, float] | None:
    side = 2 * OUTLINE_PX + 1
    inner = eroded(mask, side)
    pixels = pixels_bgr[inner if np.count_nonzero(inner) >= MIN_PIXELS else mask]
    if len(pixels) < MIN_PIXELS:
        return None
    lightness, a, b = lab_of(linear_rgb(apply_colour(pixels[None], colour)).mean(axis=(0, 1)))
    return float(lightness), float(a), float(b)
