"""The colour difference CIEDE2000 between CIELAB colours.

Source: Sharma, Wu, Dalal, "The CIEDE2000 color-difference formula: implementation notes, supplementary test data, and
mathematical observations", Color Research and Application 30 (2005); equation numbers are theirs.
"""

import numpy as np

from app.vision.model import Float64Array


def ciede2000(first_lab: Float64Array, second_lab: Float64Array) -> Float64Array:
    """(...) differences of (..., 3) L, a, b; k_L = k_C = k_H = 1. About 1 is just visible side by side."""
    l1, a1, b1 = np.moveaxis(first_lab, -1, 0)
    l2, a2, b2 = np.moveaxis(second_lab, -1, 0)
    mean_ab_chroma = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2  # eq. 2, 3
    stretch = 1.0 + 0.5 * (1.0 - _high_chroma(mean_ab_chroma))  # eq. 4, 5
    chroma1, chroma2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)  # eq. 6
    hue1, hue2 = _hue_deg(stretch * a1, b1), _hue_deg(stretch * a2, b2)  # eq. 7
    is_grey = chroma1 * chroma2 == 0.0

    hue_step = np.where(is_grey, 0.0, (hue2 - hue1 + 180.0) % 360.0 - 180.0)  # eq. 10
    lightness_difference, chroma_difference = l2 - l1, chroma2 - chroma1  # eq. 8, 9
    hue_difference = 2.0 * np.sqrt(chroma1 * chroma2) * np.sin(np.radians(hue_step / 2))  # eq. 11

    lightness, chroma = (l1 + l2) / 2, (chroma1 + chroma2) / 2  # eq. 12, 13
    hue = _mean_hue_deg(hue1, hue2, is_grey)
    tint = (  # eq. 15
        1.0
        - 0.17 * np.cos(np.radians(hue - 30.0))
        + 0.24 * np.cos(np.radians(2 * hue))
        + 0.32 * np.cos(np.radians(3 * hue + 6.0))
        - 0.20 * np.cos(np.radians(4 * hue - 63.0))
    )
    from_middle = (lightness - 50.0) ** 2
    lightness_term = lightness_difference / (
        1.0 + 0.015 * from_middle / np.sqrt(20.0 + from_middle)
    )  # eq. 18
    chroma_term = chroma_difference / (1.0 + 0.045 * chroma)  # eq. 19
    hue_term = hue_difference / (1.0 + 0.015 * chroma * tint)  # eq. 20
    turn = 30.0 * np.exp(-(((hue - 275.0) / 25.0) ** 2))  # eq. 16
    rotation = -2.0 * _high_chroma(chroma) * np.sin(np.radians(2 * turn))  # eq. 17, 21
    # eq. 22
    squared = lightness_term**2 + chroma_term**2 + hue_term**2 + rotation * chroma_term * hue_term
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)), np.float64)


def _high_chroma(chroma: Float64Array) -> Float64Array:
    """Near 0 for greys, near 1 for vivid colours (within eq. 4, and eq. 17)."""
    return np.sqrt(chroma**7 / (chroma**7 + 25.0**7))


def _hue_deg(a: Float64Array, b: Float64Array) -> Float64Array:
    return np.degrees(np.arctan2(b, a)) % 360.0


def _mean_hue_deg(hue1: Float64Array, hue2: Float64Array, is_grey: Float64Array) -> Float64Array:
    """Eq. 14: the middle of the shorter arc; a grey has no hue, so that the other's counts (one of them is 0)."""
    total = hue1 + hue2
    is_short = np.abs(hue1 - hue2) <= 180.0
    around = np.where(total < 360.0, total + 360.0, total - 360.0)
    return np.where(is_grey, total, np.where(is_short, total, around) / 2)
