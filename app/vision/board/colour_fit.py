"""The linear correction that brings the colour board's squares to their printed colours, and neutral to neutral.

Samples of the board in -> (3, 3) matrix in linear sRGB with its colour differences, or None where the squares that can
be trusted are too few or do not show the board's colours.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from app.vision.board.ciede2000 import ciede2000
from app.vision.board.colour_samples import (
    BoardSamples,
    WhiteLevel,
    is_in_full_light,
    light_by_square,
)
from app.vision.board.colour_space import LINEAR_OF_BYTE, LUMINANCE_OF_RGB, lab_of
from app.vision.marker_spec import Colour, Square
from app.vision.model import Float64Array, MaskArray

PAPER_WHITE = 0.84  # of a perfect white's light: L* 93.5, between uncoated (92) and coated (95) paper of ISO 12647-2
RIDGE = 0.05  # on the off-diagonal, in the fit's units (lightness): a tenth of what one square's colour weighs
DARK_FLOOR = 0.05  # linear; below it a colour's error counts no more, since noise, glare and the tone curve rule there
# dL*/dY at Y = 1 (CIE 15:2004, 8.2.1): makes weighted residuals about lightness units
LIGHTNESS_SLOPE = 116.0 / 3.0
# lightness units a channel; a print's own faults stay below, glare and dirt do not
MAX_RESIDUAL = 12.0
MIN_SQUARES = 6
MIN_FOR_WHITE = 4  # squares whose channel tells its gain
MAX_MEAN_DELTA_E = 8.0  # above, what was printed is not the board's colours
# of the paper among the colours; the print's own is 1, the board as published has 0.84
WHITE_RANGE = (0.65, 1.1)
MAX_MIXING = 0.6  # of one channel into another; between phones' sensors it is some tenths
MAX_CONDITION = 8.0  # of the matrix without white balance; phones' have 2 to 4, above noise grows and colours merge


@dataclass(frozen=True, slots=True)
class MatrixFit:
    """matrix: (3, 3), linear sRGB as photographed -> as printed. delta_e: (n,) CIEDE2000 of the squares it rests on.

    left_out: squares that were of no use: in a shadow's edge, clipped, in glare, dirty.
    """

    matrix: Float64Array
    delta_e: Float64Array
    left_out: int


def reference_linear(colours: Mapping[Square, Colour]) -> Float64Array:
    """(n, 3) linear sRGB of the coloured squares."""
    return np.asarray(LINEAR_OF_BYTE[np.array(list(colours.values()))], np.float64)


def fit_matrix(
    samples: BoardSamples, white: WhiteLevel, colours: Mapping[Square, Colour]
) -> MatrixFit | None:
    """Least squares over the coloured squares, each under its own light, in steps of lightness.

    The light of a square is its white neighbours', so that neither a gradient nor a shadow moves its colour. White maps
    to a grey that the colours choose: exposure follows the ten colours, neutral stays neutral (6 + 1 unknowns). Where
    white is clipped, the colours in full light choose the white balance too, that light taken to be even.
    """
    rows, columns = np.array(list(colours)).T + 1
    reference = reference_linear(colours)
    seen, usable = samples.linear[rows, columns], ~samples.is_clipped[rows, columns]
    if white.is_overexposed:
        usable &= is_in_full_light(samples, white)[rows, columns, None]
        level = _white_of_colours(seen, usable, reference)
        if level is None:
            return None
        light = np.broadcast_to(level, seen.shape)
    else:
        level, light = white.linear, light_by_square(samples)[rows, columns]
    usable &= (np.isfinite(seen) & np.isfinite(light)).all(axis=1)[:, None]
    relative = np.where(usable, seen / np.where(usable, light, 1.0), 0.0)
    share = np.nan_to_num(light @ LUMINANCE_OF_RGB / (level @ LUMINANCE_OF_RGB))
    weights = usable * _lightness_weight(reference) * np.sqrt(np.clip(share, 0.0, 1.0))[:, None]

    used = usable.any(axis=1)
    if np.count_nonzero(used) < MIN_SQUARES:
        return None
    matrix, residual = _solve(relative, reference, weights * used[:, None])
    while residual.max() > MAX_RESIDUAL and np.count_nonzero(used) > MIN_SQUARES:
        used = _without_worst(relative, reference, weights, used)
        matrix, residual = _solve(relative, reference, weights * used[:, None])
    whole = used & usable.all(axis=1)
    if residual.max() > MAX_RESIDUAL or not whole.any() or not _is_sane(matrix):
        return None
    corrected = np.clip(relative[whole] @ matrix.T, 0.0, 1.0)
    delta_e = ciede2000(lab_of(corrected), lab_of(reference[whole]))
    if delta_e.mean() > MAX_MEAN_DELTA_E:
        return None
    return MatrixFit(matrix / level, delta_e, left_out=len(used) - int(np.count_nonzero(used)))


def _white_of_colours(
    seen: Float64Array, usable: MaskArray, reference: Float64Array
) -> Float64Array | None:
    """(3,) level that white would have if the sensor had gone so far: each channel's gain by the colours alone."""
    counts = usable & np.isfinite(seen)
    if counts.sum(axis=0).min() < MIN_FOR_WHITE:
        return None
    weight = counts * _lightness_weight(reference)
    counted = np.where(counts, seen, 0.0)
    return np.asarray(
        PAPER_WHITE
        * (weight**2 * counted**2).sum(axis=0)
        / (weight**2 * counted * reference).sum(axis=0),
        np.float64,
    )


def _lightness_weight(linear: Float64Array) -> Float64Array:
    """Steps of lightness for a step of linear light: the slope of the cube root, bounded for dark colours."""
    return LIGHTNESS_SLOPE / (linear + DARK_FLOOR) ** (2 / 3)


def _solve(
    relative: Float64Array, reference: Float64Array, weights: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """The matrix, (3, 3), with equal sums of rows, and (n,) the rms of each square's weighted residuals.

    Unknowns: the sum of a row, and two off-diagonal differences a channel; a ridge draws these to 0.
    """
    count = len(relative)
    design = np.zeros((count, 3, 7))
    for channel in range(3):
        others = [other for other in range(3) if other != channel]
        design[:, channel, 0] = relative[:, channel]
        for place, other in enumerate(others):
            design[:, channel, 1 + 2 * channel + place] = relative[:, other] - relative[:, channel]
    weighted = (design * weights[..., None]).reshape(-1, 7)
    ridge = np.diag([1e-9] + [(RIDGE * LIGHTNESS_SLOPE) ** 2] * 6)
    solution = np.linalg.solve(
        weighted.T @ weighted + ridge, weighted.T @ (reference * weights).ravel()
    )
    matrix = np.eye(3) * solution[0]
    for channel in range(3):
        for place, other in enumerate(other for other in range(3) if other != channel):
            mixing = solution[1 + 2 * channel + place]
            matrix[channel, other] += mixing
            matrix[channel, channel] -= mixing
    residual = (relative @ matrix.T - reference) * weights
    squares = np.maximum((weights > 0.0).sum(axis=1), 1)
    return matrix, np.sqrt((residual**2).sum(axis=1) / squares)


def _without_worst(
    relative: Float64Array, reference: Float64Array, weights: Float64Array, used: MaskArray
) -> MaskArray:
    """The squares without the one that lets the others agree best."""
    best, least = used, np.inf
    for index in np.flatnonzero(used):
        without = used.copy()
        without[index] = False
        worst = float(_solve(relative, reference, weights * without[:, None])[1].max())
        if worst < least:
            best, least = without, worst
    return best


def _is_sane(matrix: Float64Array) -> bool:
    """Whether the paper is a white among the colours and no channel is made of another one."""
    level = float(matrix[0].sum())
    mixing = (
        np.abs(matrix - np.diag(np.diag(matrix))) / level
        if level > 0.0
        else np.full((3, 3), np.inf)
    )
    is_paper, is_apart = (
        WHITE_RANGE[0] <= level <= WHITE_RANGE[1],
        float(mixing.max()) <= MAX_MIXING,
    )
    return is_paper and is_apart and float(np.linalg.cond(matrix)) <= MAX_CONDITION
