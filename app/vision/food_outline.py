"""Each food's outline once more, from its own colours against those just around it.

Masks of foods -> the same, corrected: a hole through which the dish shows, a shadow at the foot, a strip of the dish
that hung on. What all foods together could not tell, one food's colours against its surroundings can.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from app.vision.food_pixels import SHADES, Scene, colour_bins, colour_histogram, contrast_features, shaded_lab
from app.vision.min_cut import cut_in_two
from app.vision.model import Float32Array, MaskArray

MARGIN_MM = 12.0  # around the mask, whose colours are the surroundings'
GROWTH_MM = 6.0  # by which a mask may grow
INNER_PX = 3.0  # from the outline, within which a mask's colours may be mixed
COLOUR_NATS = 5.0
UNSEEN = 3e-5  # probability of a colour that a model has not seen
PLACE_MM = 4.0  # of distance from the former outline that count for one nat
PLACE_NATS = 2.0
ROUNDS = 2


def correct_outlines(masks: Sequence[MaskArray], scene: Scene) -> list[MaskArray]:
    """(h, w) masks of the scene's grid, in their order; none of them comes to overlap another."""
    taken = np.zeros(scene.is_ignored.shape, np.uint8)
    for mask in masks:
        taken += mask
    corrected = []
    for mask in masks:
        others = (taken - mask) > 0
        own = _correct(mask, others, scene)
        taken = taken - mask + own
        corrected.append(own)
    return corrected


def _correct(mask: MaskArray, others: MaskArray, scene: Scene) -> MaskArray:
    margin = round((MARGIN_MM + GROWTH_MM) / scene.pixel_mm)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return mask
    window = (
        slice(max(0, int(rows[0]) - margin), int(rows[-1]) + margin + 1),
        slice(max(0, int(columns[0]) - margin), int(columns[-1]) + margin + 1),
    )
    image = np.ascontiguousarray(scene.image_bgr[window])
    lab = cv2.cvtColor(image, cv2.COLOR_BGR2LAB).astype(np.float32)
    bins = colour_bins(lab)
    shaded = [colour_bins(shaded_lab(image, share)) for share in SHADES]
    features = contrast_features(lab)
    is_never = others[window] | scene.is_ignored[window]
    place = _signed_depth_px(mask[window]) * scene.pixel_mm
    is_never |= place < -GROWTH_MM
    place = np.clip(place / PLACE_MM, -PLACE_NATS, PLACE_NATS)
    found = mask[window]
    nothing = np.zeros(found.shape, np.bool_)
    for _ in range(ROUNDS):
        depth = _signed_depth_px(found)
        inner = depth > min(INNER_PX, 0.5 * float(depth.max()))
        outer = (depth < -2) & (depth > -MARGIN_MM / scene.pixel_mm) & ~others[window] & ~scene.is_ignored[window]
        if not (inner.any() and outer.any()):
            return mask
        own, around = colour_histogram([bins], inner), colour_histogram([bins, *shaded], outer)
        ratio = np.clip(np.log((own + UNSEEN) / (around + UNSEEN))[bins], -COLOUR_NATS, COLOUR_NATS)
        found = cut_in_two((ratio + place).astype(np.float32), features, is_never, nothing)
        if not found.any():
            return mask
    out = np.zeros(mask.shape, np.bool_)
    out[window] = _largest(found)
    return out


def _signed_depth_px(mask: MaskArray) -> Float32Array:
    """(H, W) distance to the outline, px, negative outside."""
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(inside - outside, np.float32)


def _largest(mask: MaskArray) -> MaskArray:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count < 2:
        return mask
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()), np.bool_)
