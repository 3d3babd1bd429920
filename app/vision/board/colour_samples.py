"""The colours of a found board's squares and margin, in linear light, and the light that falls on each of them.

Photograph and corners in -> BoardSamples, the level of white, light by square. What the colours should be is for
colour_fit.py.
"""

from dataclasses import dataclass

import numpy as np

from app.vision.board.colour_space import LINEAR_OF_BYTE, LUMINANCE_OF_RGB
from app.vision.board.grid import grid_homography, sample_squares
from app.vision.board.print_layout import seen_tags_px
from app.vision.board.tag_bits import read_tag_cells
from app.vision.marker_spec import MarkerSpec, TagBoard
from app.vision.model import Float64Array, ImageArray, MarkerObservation, MaskArray

HALF_SIDE_SQUARES = 0.25  # about a square's middle: lens, blur and sharpening spill over edges, crumpled corners stray
SAMPLES_A_SIDE = 15
DARKEST = 1e-4  # linear, a third of a byte's first step
BLACK_BYTE = 50
CLIPPED_BYTE = 254  # JPEG moves a clipped 255 by one
# of a square's samples: up to there the mean of their middle half does not feel it
CLIPPED_SHARE = 0.25
LIT_SHARE = 0.75  # of the sheet's bright paper; what is darker lies in a shadow or under something
BRIGHT_PERCENTILE = 80
MIN_WHITES = 3
MIN_GOOD_SHARE = 0.75  # of the lit paper; where more is clipped the rest lies in weaker light
# linear; below it a byte's step is a twentieth and more of the black squares' level
MIN_WHITE = 0.02
EVEN_LIGHT = 1.12  # brightest by darkest of three white neighbours of an evenly lit square; a shadow's edge has 1.5
SLOPING_LIGHT = 1.3  # of two opposite ones, where the other two tell the same level
SAME_LIGHT = 1.08  # between what the two pairs of opposite neighbours tell


@dataclass(frozen=True, slots=True)
class BoardSamples:
    """Squares with one ring of the margin around them, (rows + 2, columns + 2), or a board of tags laid out like that.

    linear: (.., 3) red first, the mean of the middle half of the samples; NaN outside the photograph.
    is_clipped: (.., 3). is_white: squares and margin where the paper is white. is_black: printed black.
    """

    linear: Float64Array
    is_clipped: MaskArray
    is_white: MaskArray
    is_black: MaskArray

    @property
    def luminance(self) -> Float64Array:
        """(rows + 2, columns + 2), linear."""
        return np.asarray(self.linear @ LUMINANCE_OF_RGB, np.float64)


@dataclass(frozen=True, slots=True)
class WhiteLevel:
    """The sheet's paper where it is lit.

    linear: (3,) red first. is_overexposed: much of it is clipped, and linear but a lower bound. is_lit: (rows + 2,
    columns + 2), white places in this light. is_partly_dark: some of the paper lies in a shadow or is covered.
    """

    linear: Float64Array
    is_overexposed: bool
    is_lit: MaskArray
    is_partly_dark: bool


def sample_board(pixels_bgr: ImageArray, marker: MarkerObservation) -> BoardSamples | None:
    """The middle of every square and of one square's width of margin; None for corners that make no grid.

    Of a board of tags: see _sample_tags.
    """
    spec = marker.spec
    if isinstance(spec, TagBoard):
        return _sample_tags(pixels_bgr, marker, spec)
    count = (spec.rows - 1) * (spec.columns - 1)
    if marker.corners_px.shape != (count, 2) or not np.isfinite(marker.corners_px).all():
        return None
    fitted = grid_homography(marker.grid_px)
    if fitted is None:
        return None
    side = np.linspace(-HALF_SIDE_SQUARES, HALF_SIDE_SQUARES, SAMPLES_A_SIDE)
    offsets = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    sampled = sample_squares(
        pixels_bgr, fitted[0], (spec.rows + 2, spec.columns + 2), offsets, ring=1
    )
    if sampled is None:
        return None
    values, is_inside = sampled
    squares = np.sort(values[..., ::-1], axis=2)
    quarter = len(offsets) // 4
    linear = LINEAR_OF_BYTE[squares[:, :, quarter:-quarter]].mean(axis=2)
    linear[~is_inside.all(axis=2)] = np.nan
    is_white, is_black = _places(marker.spec)
    is_clipped = (squares >= CLIPPED_BYTE).mean(axis=2) > CLIPPED_SHARE
    return BoardSamples(linear, is_clipped, is_white, is_black)


def _sample_tags(pixels_bgr: ImageArray, marker: MarkerObservation, spec: TagBoard) -> BoardSamples:
    """The black and the white cells of each tag in view, side by side as squares of a checkerboard; NaN elsewhere.

    (rows + 2, 2 columns + 2): each black place borders on its own tag's white one and on those of the tags around it.
    """
    size = (spec.rows + 2, 2 * spec.columns + 2)
    linear, is_clipped = np.full((*size, 3), np.nan), np.zeros((*size, 3), bool)
    is_black = np.zeros(size, bool)
    places = spec.tag_places()
    for row, column in places:
        is_black[row + 1, 2 * column + row % 2 + 1] = True
    ids, quads_px = seen_tags_px(marker, spec)
    for tag, quad in zip(ids, quads_px, strict=True):
        row, column = places[tag]
        for place, values in enumerate(read_tag_cells(pixels_bgr, spec, int(tag), quad)):
            at = row + 1, 2 * column + (place + row) % 2 + 1
            cells = np.sort(values[:, ::-1], axis=0)
            quarter = len(cells) // 4
            linear[at] = LINEAR_OF_BYTE[cells[quarter : len(cells) - quarter]].mean(axis=0)
            is_clipped[at] = (cells >= CLIPPED_BYTE).mean(axis=0) > CLIPPED_SHARE
    return BoardSamples(linear, is_clipped, ~is_black, is_black)


def find_white(samples: BoardSamples) -> WhiteLevel | None:
    """The median of the white squares and margin that are lit and not clipped; None where it is too dark to tell."""
    luminance = np.where(samples.is_white, samples.luminance, np.nan)
    is_seen = np.isfinite(luminance)
    if np.count_nonzero(is_seen) < MIN_WHITES:
        return None
    bright = np.percentile(luminance[is_seen], BRIGHT_PERCENTILE)
    is_lit = is_seen & (np.nan_to_num(luminance) >= LIT_SHARE * bright)
    is_dark = is_seen & ~is_lit
    is_good = is_lit & ~samples.is_clipped.any(axis=-1)
    is_overexposed = bool(np.count_nonzero(is_good) < MIN_GOOD_SHARE * np.count_nonzero(is_lit))
    white = np.median(samples.linear[is_lit if is_overexposed else is_good], axis=0)
    if white.min() < MIN_WHITE:
        return None
    return WhiteLevel(
        linear=white,
        is_overexposed=is_overexposed,
        is_lit=is_lit,
        # food may cover the margin
        is_partly_dark=bool(is_dark[1:-1, 1:-1].any() and np.count_nonzero(is_dark) > 1),
    )


def light_by_square(samples: BoardSamples) -> Float64Array:
    """(rows + 2, columns + 2, 3) level of white at each dark or coloured square, by the white ones that it borders on.

    Opposite neighbours tell it by their mean, so that light may grow steadily, and both pairs must tell the same; or
    else three of the four alike. NaN where neither holds (the edge of a shadow runs through) and by clipped ones.
    """
    levels = np.where(samples.is_clipped.any(axis=-1, keepdims=True), np.nan, samples.linear)
    light = np.full(levels.shape, np.nan)
    for row, column in np.argwhere(~samples.is_white):
        beside = levels[[row - 1, row + 1, row, row], [column, column, column - 1, column + 1]]
        light[row, column] = _light_amid(beside)
    return light


def _light_amid(beside: Float64Array) -> Float64Array:
    """(3,) level between (4, 3) neighbours: above, below, left, right; NaN where they do not agree."""
    pairs = [pair for pair in (beside[:2], beside[2:]) if np.isfinite(pair).all()]
    means = np.array([np.sqrt(pair[0] * pair[1]) for pair in pairs])
    if len(pairs) == 2 and max(map(_ratio, pairs)) <= SLOPING_LIGHT and _ratio(means) <= SAME_LIGHT:
        return np.asarray(means.mean(axis=0), np.float64)
    measured = beside[np.isfinite(beside).all(axis=1)]
    measured = measured[np.argsort(measured @ LUMINANCE_OF_RGB, kind="stable")]
    for start in range(len(measured) - MIN_WHITES, -1, -1):  # the brighter three first
        three = measured[start : start + MIN_WHITES]
        if _ratio(three) <= EVEN_LIGHT:
            return np.asarray(three.mean(axis=0), np.float64)
    return np.full(3, np.nan)


def is_in_full_light(samples: BoardSamples, white: WhiteLevel) -> MaskArray:
    """(rows + 2, columns + 2) dark or coloured squares all of whose white neighbours are lit."""
    out = np.zeros(samples.is_white.shape, bool)
    for row, column in np.argwhere(~samples.is_white):
        beside = ([row - 1, row + 1, row, row], [column, column, column - 1, column + 1])
        out[row, column] = white.is_lit[beside].all()
    return out


def _ratio(levels: Float64Array) -> float:
    """Brightest by darkest of (n, 3) linear colours."""
    luminance = levels @ LUMINANCE_OF_RGB
    return float(luminance.max() / max(luminance.min(), DARKEST))


def _places(spec: MarkerSpec) -> tuple[MaskArray, MaskArray]:
    """(rows + 2, columns + 2) where the print is white, margin included, and where it is black."""
    size = (spec.rows + 2, spec.columns + 2)
    is_white, is_black = np.ones(size, bool), np.zeros(size, bool)
    for row, column in spec.squares:
        colour = spec.square_colour((row, column))
        if colour is not None:
            is_white[row + 1, column + 1] = False
            is_black[row + 1, column + 1] = max(colour) < BLACK_BYTE
    return is_white, is_black
