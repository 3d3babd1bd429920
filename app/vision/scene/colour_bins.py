"""Colours of the reduced picture as histograms and contrasts: what tells food, dish, table and their shadows apart."""

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.pictures import blurred, grey_of, lab_bytes
from app.vision.model import Float32Array, ImageArray, MaskArray
from app.vision.tuning import COLOUR_TUNING

SHADES = (0.75, 0.55, 0.4, 0.28)  # of the light that may be left in the shadow of a food
SHADE_WEIGHT = 0.15
SPREAD_BINS = 1.2  # standard deviation of one surface's colours, at least
REACH_SDS = 3.5  # of a blur
BIN_COUNTS = (24, 32, 32)
LIGHT_WEIGHT = 0.7  # of lightness in the contrast; shadows are contrasts of lightness alone
CHROMA_GAIN = 2.0
MAX_STEEPNESS = 12.0
UNSEEN = 3e-5  # probability of a colour that a model has not seen
COLOUR_NATS = 4.0  # that one pixel's colour says at most
MIN_CHROMA_APART = 4.0  # of two sides, to speak of a direction


def contrast_features(
    lab: Float32Array, sides: tuple[MaskArray, MaskArray] | None = None
) -> ImageArray:
    """(H, W, 2) lightness and chroma along one direction, as the cut sees contrast. lab: (H, W, 3), 0-255.

    sides: two masks along whose difference of chroma contrast counts: a cheese on a red and white cloth differs from it
    in yellow. Without them, or where they hardly differ, along the direction of most chroma.
    """
    chroma = lab[..., 1:] - 128.0
    spread = np.cov(np.ascontiguousarray(chroma.reshape(-1, 2).T))
    axis = np.linalg.eigh(spread + np.eye(2) * 1e-6)[1][:, 1]
    if sides is not None:
        apart = chroma[sides[0]].mean(axis=0) - chroma[sides[1]].mean(axis=0)
        length = float(np.hypot(*apart))
        axis = apart / length if length > MIN_CHROMA_APART else axis
    a, b = CHROMA_GAIN * axis
    weights = np.array([[LIGHT_WEIGHT, 0.0, 0.0, 0.0], [0.0, a, b, 128.0 * (1.0 - a - b)]])
    return np.clip(cv2.transform(lab, weights), 0, 255).astype(np.uint8)


def fine_texture(image_bgr: ImageArray) -> Float32Array:
    """(H, W) mean absolute difference of grey from its surroundings, grey levels: what grain a surface has."""
    grey = grey_of(image_bgr).astype(np.float32)
    return blurred(np.abs(grey - blurred(grey, 2.0)), 2.0)


def outline_steepness(image_bgr: ImageArray) -> Float32Array:
    """(H, W) steepest change of colour within a pixel of each, CIELAB bytes a pixel: high along a food's outline.

    At most MAX_STEEPNESS, so that a short run against a bright support does not outweigh the rest of an outline. A
    shadow's border is blurred by the size of the lamp.
    """
    smooth = blurred(lab_bytes(image_bgr), 1.0)
    slopes = [cv2.Scharr(smooth, cv2.CV_32F, *axis, scale=1 / 32) for axis in ((1, 0), (0, 1))]
    change = np.sqrt(np.sum(np.square(slopes), axis=(0, 3)))
    return np.minimum(cv2.dilate(change, np.ones((3, 3), np.uint8)), MAX_STEEPNESS).astype(
        np.float32
    )


def colour_bins(lab: Float32Array) -> NDArray[np.int64]:
    """(H, W) index into a histogram that is finer for greyish colours."""
    lightness = np.clip(lab[..., 0] / 256 * BIN_COUNTS[0], 0, BIN_COUNTS[0] - 1).astype(np.int64)
    chroma = lab[..., 1:] - 128.0
    step = np.where(np.abs(chroma) < 24, np.abs(chroma) / 3, 8 + (np.abs(chroma) - 24) / 10)
    a, b = np.moveaxis(np.clip(16 + np.sign(chroma) * step, 0, 31).astype(np.int64), -1, 0)
    return np.asarray((lightness * BIN_COUNTS[1] + a) * BIN_COUNTS[2] + b, np.int64)


def byte_bins(image_bgr: ImageArray) -> NDArray[np.int64]:
    """(H, W) colour_bins of a picture in bytes, by tables of what each byte's share of the index is."""
    lab = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2LAB)
    return np.asarray(cv2.transform(cv2.LUT(lab, _byte_tables()), np.ones((1, 3))), np.int64)


@cache
def _byte_tables() -> Float32Array:
    """(1, 256, 3) what each byte of L*, a* and b* adds to the index; of a* and b*, beyond what grey adds."""
    steps = np.full((3, 256, 3), 128.0, np.float32)
    for axis in range(3):
        steps[axis, :, axis] = np.arange(256)
    tables = colour_bins(steps)
    tables[1:] -= tables[1:, 128:129]
    return np.ascontiguousarray(tables.T[None], np.float32)


def shaded_bins(image_bgr: ImageArray) -> list[NDArray[np.int64]]:
    """The bins of the image as it would look with each of SHADES of its light (of linear intensities, gamma 2.2)."""
    darker = (cv2.convertScaleAbs(image_bgr, alpha=share ** (1 / 2.2)) for share in SHADES)
    return [byte_bins(np.asarray(image, np.uint8)) for image in darker]


def colour_evidence(first: Float32Array, second: Float32Array) -> Float32Array:
    """Log likelihood of each bin for the first of two histograms over the second."""
    ratio = np.log((first + UNSEEN) / (second + UNSEEN))
    return np.clip(ratio, -COLOUR_NATS, COLOUR_NATS)


def colour_histogram(versions: list[NDArray[np.int64]], where: MaskArray) -> Float32Array:
    """Probability of each bin, smoothed. versions: the bins, and those of the same pixels in shadow, of less weight."""
    counts = [
        np.bincount(bins[where], minlength=int(np.prod(BIN_COUNTS))).astype(np.float32)
        for bins in versions
    ]
    smooth = _smoothed(counts[0], SPREAD_BINS)
    if len(counts) > 1:
        in_shadow = np.sum(counts[1:], axis=0) * (SHADE_WEIGHT / 2)
        for spread in (
            SPREAD_BINS,
            COLOUR_TUNING.cast_bins,
        ):  # a shadow that is coloured, and one that is not
            smooth = smooth + _smoothed(in_shadow, spread)
    return smooth.ravel() / max(1.0, float(smooth.sum()))


def _smoothed(counts: Float32Array, chroma_bins: float) -> Float32Array:
    """Return counts of all bins (n,), smoothed; chroma_bins: standard deviation along chroma."""
    by_light = counts.reshape(BIN_COUNTS)
    along_chroma = [_blurred(plane, (chroma_bins, chroma_bins)) for plane in by_light]
    flat = np.asarray(along_chroma, np.float32).reshape(BIN_COUNTS[0], -1)
    return _blurred(flat, (0.0, SPREAD_BINS)).ravel()


def _blurred(plane: Float32Array, sds: tuple[float, float]) -> Float32Array:
    """Return a plane (rows, columns) blurred by sds across and down, nothing beyond it."""
    size = [2 * round(REACH_SDS * sd) + 1 for sd in sds]
    blurred_plane = cv2.GaussianBlur(
        plane, size, sigmaX=sds[0], sigmaY=sds[1], borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(blurred_plane, np.float32)
