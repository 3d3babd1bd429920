"""A food cut out of the picture by its colours against those around it: one that a person or a seed points at.

Seed or first guess, surroundings -> the food's mask by a minimum cut.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.masks import dilated, distance_px, eroded, largest_part, touching
from app.vision.geometry.pictures import lab_bytes
from app.vision.model import Float32Array, ImageArray, MaskArray
from app.vision.scene.colour_bins import (
    byte_bins,
    colour_evidence,
    colour_histogram,
    contrast_features,
    outline_steepness,
    shaded_bins,
)
from app.vision.scene.min_cut import cut_in_two
from app.vision.scene.scene import Scene

POINT_REACH_MM = 60.0  # from a point, beyond which its food is not looked for
POINT_MARGIN_MM = 15.0
BIAS_NATS = 0.8  # towards food, of each try
MAX_BIASES = 6
ROUNDS = 2


@dataclass(frozen=True, slots=True)
class Palette:
    """Bins of a picture's colours, (H, W), those of the same pixels in shadow, and its contrasts: colour_bins.py."""

    bins: NDArray[np.int64]
    shaded: list[NDArray[np.int64]]
    features: ImageArray


def palette_of(image_bgr: ImageArray) -> Palette:
    """Return the palette of a picture, for all cuts of it."""
    lab = lab_bytes(image_bgr)
    return Palette(byte_bins(image_bgr), shaded_bins(image_bgr), contrast_features(lab))


def cut_around(
    point: MaskArray, taken: MaskArray, scene: Scene, evidence: Float32Array
) -> MaskArray:
    """The food that a point lies in.

    point: (h, w) a small disc. taken: (h, w) other foods. evidence: see cut_out. The point's few colours are not all
    that the food has, and may be those of a shadow on its support: of the cuts with more and more favour for food, the
    one of the steepest outline (colour_bins.outline_steepness) is taken.
    """
    from_point = distance_px(point) * scene.pixel_mm
    allowed = (from_point < POINT_REACH_MM) & ~taken & ~scene.is_ignored
    around = (
        (from_point >= POINT_REACH_MM)
        & (from_point < POINT_REACH_MM + POINT_MARGIN_MM)
        & ~scene.is_ignored
    )
    steepness, is_free = outline_steepness(scene.image_bgr), ~dilated(taken | scene.is_ignored, 3)
    seed = point & allowed
    best, steepest = seed, 0.0
    if not seed.any():
        return best
    palette = palette_of(scene.image_bgr)
    for step in range(MAX_BIASES):
        mask = touching(
            cut_out(seed, around, allowed, palette, evidence, step * BIAS_NATS, seed), point
        )
        outline = mask & ~eroded(mask, 3) & is_free
        steep = float(steepness[outline].mean()) if outline.any() else 0.0
        if steep > steepest:
            best, steepest = mask, steep
    return best


def cut_out(
    food: MaskArray,
    around: MaskArray,
    allowed: MaskArray,
    palette: Palette,
    evidence: Float32Array,
    bias_nats: float,
    always: MaskArray | None = None,
) -> MaskArray:
    """The largest part of the minimum cut between what food and around teach of colours.

    evidence: (h, w) what else speaks for food, nats. always: (h, w) what is food for certain.
    """
    bins = palette.bins
    mask = food
    for _ in range(ROUNDS):
        if not (mask.any() and around.any()):
            break
        inside, outside = (
            colour_histogram([bins], mask),
            colour_histogram([bins, *palette.shaded], around | (allowed & ~mask & ~food)),
        )
        ratio = colour_evidence(inside, outside)[bins]
        nothing = np.zeros(mask.shape, np.bool_)
        cut = cut_in_two(
            (ratio + evidence + bias_nats).astype(np.float32),
            palette.features,
            ~allowed,
            nothing if always is None else always,
        )
        if not cut.any():
            break
        mask = largest_part(cut)
    return mask & allowed
