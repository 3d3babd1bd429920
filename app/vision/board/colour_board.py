"""The colour board: which square has which colour, and whether the squares of a photographed grid are its squares.

4 squares across, 5 down, on white; the squares that are not listed are white.
"""

import numpy as np

from app.vision.model import Float64Array

COLOUR_SQUARES: dict[
    tuple[int, int], tuple[int, int, int]
] = {  # (row, column) from the top left -> sRGB
    (0, 1): (60, 190, 205),
    (0, 3): (225, 60, 45),
    (1, 0): (140, 130, 40),
    (1, 2): (25, 25, 28),
    (2, 1): (215, 85, 165),
    (2, 3): (55, 165, 75),
    (3, 0): (235, 110, 40),
    (3, 2): (165, 35, 45),
    (4, 1): (240, 215, 50),
    (4, 3): (65, 70, 160),
}
MIN_CHROMA = 0.2  # mean over the dark squares, of white's level; the colour board has 0.5, a black and white one 0.05
# mean over squares and channels, of white's level; light and white balance move it by 0.1
MAX_COLOUR_DISTANCE = 0.25


def dark_square_chroma(means_bgr: Float64Array, first_is_dark: bool) -> float:
    """Mean of (largest - smallest channel) over the dark squares, white squares made neutral, white = 1.

    means_bgr: (rows, columns, 3), grey levels.
    """
    dark = (np.indices(means_bgr.shape[:2]).sum(axis=0) % 2 == 0) == first_is_dark
    relative = means_bgr[dark] / _white_level(means_bgr, ~dark)
    return float(np.mean(relative.max(axis=1) - relative.min(axis=1)))


def matches_colour_board(means_bgr: Float64Array) -> bool:
    """Whether (5, 4, 3) mean grey levels, read the right way up, show the colour board's squares in their places."""
    places = np.array(list(COLOUR_SQUARES))
    expected = np.array(list(COLOUR_SQUARES.values()), np.float64)[:, ::-1] / 255.0
    light = np.ones(means_bgr.shape[:2], bool)
    light[tuple(places.T)] = False
    measured = means_bgr[tuple(places.T)] / _white_level(means_bgr, light)
    return bool(np.mean(np.abs(measured - expected)) < MAX_COLOUR_DISTANCE)


def _white_level(means_bgr: Float64Array, light: np.ndarray) -> Float64Array:
    """(3,) median of the white squares, at least one grey level."""
    return np.asarray(np.maximum(np.median(means_bgr[light], axis=0), 1.0), np.float64)
