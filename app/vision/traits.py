"""What an item is known again by in another pair of the same meal: where it stands, how large it is, its colour.

Region and points on the rectified grid -> ItemTraits. The sheet of the marker is the white of the colours, so that
another light or the phone's white balance changes them little. What belongs together is for leftovers.py.
"""

import cv2
import numpy as np

from app.vision.features import is_on_sheet
from app.vision.model import Float32Array, Float64Array, ImageArray, ItemTraits, MarkerSpec, MaskArray

OUTLINE_PX = 2  # of a region is mixed with what lies behind it
BRIGHT_SHARE = 0.25  # of the sheet's pixels: more than half of a board is paper
MIN_PIXELS = 20
D65_XYZ_OF_RGB = np.array(  # linear sRGB to XYZ, IEC 61966-2-1
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
CIE_EPSILON, CIE_KAPPA = 216 / 24389, 24389 / 27  # CIE 15:2004, 8.2.1


def traits_of(mask: MaskArray, points_table: Float32Array, pixels_bgr: ImageArray, white: Float64Array) -> ItemTraits:
    """An item's traits. mask: (H, W); points_table: (H, W, 3) mm, NaN; pixels_bgr: (H, W, 3); white: sheet_white's."""
    points = points_table[mask][:, :2]
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    centre_mm, radius_mm = None, None
    if len(points) >= MIN_PIXELS:
        middle = np.median(points, axis=0)
        centre_mm = (float(middle[0]), float(middle[1]))
        radius_mm = float(np.sqrt(2.0 * np.median(np.sum((points - middle) ** 2, axis=1))))  # half a disc's area
    return ItemTraits(centre_mm, radius_mm, _lab(mask, pixels_bgr, white))


def sheet_white(spec: MarkerSpec, plane_mm: Float32Array, pixels_bgr: ImageArray, is_seen: MaskArray) -> Float64Array:
    """(3,) linear R, G, B of the sheet's paper, 1 = the sensor's full scale; ones where the sheet is not seen.

    plane_mm: (H, W, 3) where each line of sight meets the marker's plane.
    """
    pixels = pixels_bgr[is_on_sheet(spec, plane_mm) & is_seen]
    if len(pixels) < MIN_PIXELS:
        return np.ones(3)
    brightness = pixels.sum(axis=1, dtype=np.int64)
    paper = pixels[brightness >= np.quantile(brightness, 1.0 - BRIGHT_SHARE)]
    return np.maximum(np.median(_linear_rgb(paper), axis=0), 1.0 / 255.0)


def lab_of(linear_rgb: Float64Array) -> Float64Array:
    """(..., 3) linear sRGB, white = 1, -> CIELAB (D65) L, a, b (CIE 15:2004, 8.2.1)."""
    relative = linear_rgb @ D65_XYZ_OF_RGB.T / D65_XYZ_OF_RGB.sum(axis=1)
    f = np.where(relative > CIE_EPSILON, np.cbrt(relative), (CIE_KAPPA * relative + 16.0) / 116.0)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _lab(mask: MaskArray, pixels_bgr: ImageArray, white: Float64Array) -> tuple[float, float, float] | None:
    side = 2 * OUTLINE_PX + 1
    inner = cv2.erode(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    pixels = pixels_bgr[inner if np.count_nonzero(inner) >= MIN_PIXELS else mask]
    if len(pixels) < MIN_PIXELS:
        return None
    lightness, a, b = lab_of(_linear_rgb(pixels).mean(axis=0) / white)
    return float(lightness), float(a), float(b)


def _linear_rgb(pixels_bgr: ImageArray) -> Float64Array:
    """(n, 3) sRGB bytes, blue first -> linear, red first (IEC 61966-2-1)."""
    share = pixels_bgr[:, ::-1].astype(np.float64) / 255.0
    return np.asarray(np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4), np.float64)
