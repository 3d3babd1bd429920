"""Colour calibration by the marker: white balance, exposure and, from the colour board, a linear correction.

measure_colour: photograph and found marker -> ColourCorrection. apply_colour: pixels -> corrected pixels, for features
and for eyes; geometry stays on the pixels as taken. docs/volume.md tells what is done and how well.
"""

import cv2
import numpy as np

from app.vision.board.colour_fit import PAPER_WHITE, fit_matrix
from app.vision.board.colour_samples import BoardSamples, find_white, light_by_square, sample_board
from app.vision.board.colour_space import LINEAR_OF_BYTE, LUMINANCE_OF_RGB, encode_srgb, linear_rgb
from app.vision.model import ColourCorrection, Float64Array, ImageArray, MarkerObservation, Photo

# of white's light; printed black has 0.04 to 0.08, more than a quarter is glare or haze
MAX_BLACK_SHARE = 0.25
BRIGHT_PERCENTILE = 95
MAX_BRIGHT = 1.25  # of a perfect white in the marker's light; brighter surfaces are few where both have the same light
EVERY_PX = 8  # of the photograph, for its brightness
HIGHLIGHT_BYTE = 247  # from here up a channel nears its end, and what it lost is unknown
ROWS_AT_ONCE = 256
FINE = 65535  # steps of linear light; the dark end of sRGB needs some 4,000
BYTE_OF_FINE = np.rint(255.0 * encode_srgb(np.arange(FINE + 1) / FINE)).astype(np.uint8)

UNCORRECTED = ColourCorrection(np.eye(3), "none", flags=("colour_uncorrected",))


def measure_colour(photo: Photo, marker: MarkerObservation) -> ColourCorrection:
    """What brings this photograph's colours to those under a neutral light, exposed for the marker.

    Falls back by steps: the colour board's matrix, white balance, nothing. Flags: docs/flags.md, "Colour".
    """
    samples = sample_board(photo.pixels_bgr, marker)
    white = find_white(samples) if samples is not None else None
    if samples is None or white is None:
        return UNCORRECTED
    colours = marker.spec.colours
    fit = fit_matrix(samples, white, colours) if colours else None
    matrix = fit.matrix if fit is not None else np.diag(PAPER_WHITE / white.linear)
    flags = [
        flag
        for flag, holds in (
            ("marker_partly_shadowed", white.is_partly_dark),
            ("marker_overexposed", white.is_overexposed),
            ("marker_washed_out", _is_washed_out(samples)),
            ("marker_colours_left_out", fit is not None and fit.left_out > 0),
            ("colour_white_only", marker.spec.is_coloured and fit is None),
        )
        if holds
    ]
    brightest = _brightness(photo.pixels_bgr, matrix)
    if brightest > MAX_BRIGHT:
        matrix = matrix * (MAX_BRIGHT / brightest)
        flags.append("marker_darker_than_scene")
    return ColourCorrection(
        matrix=matrix,
        kind="colour" if fit is not None else "white",
        delta_e_mean=float(fit.delta_e.mean()) if fit is not None else None,
        delta_e_worst=float(fit.delta_e.max()) if fit is not None else None,
        flags=tuple(flags),
    )


def apply_colour(pixels_bgr: ImageArray, correction: ColourCorrection) -> ImageArray:
    """(H, W, 3) corrected, a new array. What was clipped as white stays neutral."""
    if correction.kind == "none":
        return pixels_bgr.copy()
    # the light that becomes (1, 1, 1)
    neutral = np.asarray(np.linalg.solve(correction.matrix, np.ones(3)), np.float64)
    balanced = _balanced_levels(1.0 / neutral)
    if correction.kind == "white":
        levels = np.rint(255.0 * encode_srgb(balanced)).astype(np.uint8)
        return np.asarray(cv2.LUT(pixels_bgr, levels[None, :, ::-1]), np.uint8)
    lookup = balanced[None, :, ::-1].astype(np.float32)
    mixing = ((correction.matrix * neutral)[::-1, ::-1] * FINE).astype(np.float32)
    out = np.empty_like(pixels_bgr)
    for start in range(0, len(pixels_bgr), ROWS_AT_ONCE):
        strip = slice(start, start + ROWS_AT_ONCE)
        mixed = cv2.transform(cv2.LUT(np.ascontiguousarray(pixels_bgr[strip]), lookup), mixing)
        np.clip(mixed + np.float32(0.5), 0.0, FINE, out=mixed)
        out[strip] = BYTE_OF_FINE[mixed.astype(np.uint16)]
    return out


def _is_washed_out(samples: BoardSamples) -> bool:
    """Whether the black squares are too light for print: glare on the sheet, haze in the lens."""
    black = samples.luminance[samples.is_black]
    light = light_by_square(samples)[samples.is_black] @ LUMINANCE_OF_RGB
    share = (black / light)[np.isfinite(black) & np.isfinite(light)]
    return bool(len(share) and np.median(share) > MAX_BLACK_SHARE)


def _brightness(pixels_bgr: ImageArray, matrix: Float64Array) -> float:
    """How bright the photograph's bright parts become, a perfect white in the marker's light = 1."""
    corrected = linear_rgb(pixels_bgr[::EVERY_PX, ::EVERY_PX].reshape(-1, 3)) @ matrix.T
    return float(np.percentile(corrected @ LUMINANCE_OF_RGB, BRIGHT_PERCENTILE))


def _balanced_levels(gains: Float64Array) -> Float64Array:
    """(256, 3) linear level of each byte under (3,) gains, red first, neutral where a neutral surface is; at most 1.

    A clipped channel has lost how bright it was, and one gain a channel would tint what was clipped in all of them. So
    the last bytes run up to one common grey: to full white where a gain brightens, else to the middle between what the
    brightest channel showed and white, since nothing on a table is whiter.
    """
    common = 1.0 if gains.max() >= 1.0 else 0.5 * (1.0 + float(gains.max()))
    share = np.clip((np.arange(256) - HIGHLIGHT_BYTE) / (255 - HIGHLIGHT_BYTE), 0.0, 1.0)[:, None]
    raised = 1.0 + share * (np.maximum(common / gains, 1.0) - 1.0)
    return np.minimum(LINEAR_OF_BYTE[:, None] * gains * raised, 1.0)
