"""sRGB bytes, linear sRGB and CIELAB, to and fro: the only place where the formulas stand.

Bytes are blue first as in OpenCV's images, linear values red first as in the standards.
"""

import numpy as np

from app.vision.model import Float64Array, ImageArray

D65_XYZ_OF_RGB = np.array(  # linear sRGB to XYZ, IEC 61966-2-1
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
LUMINANCE_OF_RGB = D65_XYZ_OF_RGB[1]
CIE_EPSILON, CIE_KAPPA = 216 / 24389, 24389 / 27  # CIE 15:2004, 8.2.1


def decode_srgb(share: Float64Array) -> Float64Array:
    """Values in sRGB, white = 1, as linear light (IEC 61966-2-1)."""
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def encode_srgb(linear: Float64Array) -> Float64Array:
    """The reverse of decode_srgb; what lies outside 0 to 1 is clipped."""
    inside = np.clip(linear, 0.0, 1.0)
    return np.where(inside <= 0.0031308, 12.92 * inside, 1.055 * inside ** (1 / 2.4) - 0.055)


LINEAR_OF_BYTE = decode_srgb(np.arange(256) / 255.0)


def linear_rgb(pixels_bgr: ImageArray) -> Float64Array:
    """(..., 3) sRGB bytes, blue first -> linear, red first, white = 1."""
    return LINEAR_OF_BYTE[pixels_bgr[..., ::-1]]


def lab_of(linear: Float64Array) -> Float64Array:
    """(..., 3) linear sRGB, white = 1, -> CIELAB (D65) L, a, b (CIE 15:2004, 8.2.1)."""
    relative = linear @ D65_XYZ_OF_RGB.T / D65_XYZ_OF_RGB.sum(axis=1)
    f = np.where(relative > CIE_EPSILON, np.cbrt(relative), (CIE_KAPPA * relative + 16.0) / 116.0)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)
