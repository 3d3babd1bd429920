"""The outline of foods without what hung on to it: checks of a cloth, which would look like notches.

A mask of foods, not yet told apart -> the same; small pieces go that look like what lies around.
"""

import numpy as np

from app.vision.geometry.masks import (
    components,
    filled,
    inward_px,
    largest_part,
    solidity,
    window_around,
)
from app.vision.geometry.pictures import lab_bytes
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.colour_bins import (
    byte_bins,
    colour_evidence,
    colour_histogram,
    contrast_features,
    shaded_bins,
)
from app.vision.scene.min_cut import cut_in_two
from app.vision.scene.scene import FINE_REACH_PX, Scene

MARGIN_MM = 12.0  # around the mask, whose colours are the surroundings'
GROWTH_MM = 6.0  # by which a mask may grow
INNER_PX = 3.0  # from the outline, within which a mask's colours may be mixed
PLACE_MM = 4.0  # of distance from the former outline that count for one nat
PLACE_NATS = (-2.0, 1.0)
RAISED_MM = 5.0
RAISED_NATS = 1.5
FLAT_MM = 2.5  # about the support: it shows there, whatever its colour
MAX_PIECE = 0.07  # of the mask: a larger one is a shaded side
# of its convex hull that the outline fills, where several pieces together may be more
MORE_SOLID = 0.02
ROUNDS = 2


def tidy_outlines(foods: MaskArray, scene: Scene, floor_mm: float) -> MaskArray:
    """Return the foods (h, w) without small pieces, where their outlines are more convex without them.

    floor_mm: of a board over the table, else 0
    """
    tidied = np.zeros(foods.shape, np.bool_)
    for mask in components(foods):
        own = _recut(mask, foods & ~mask, scene, floor_mm)
        tidied |= own if _is_tidier(own, mask, scene, floor_mm) else mask
    return tidied


def _recut(mask: MaskArray, others: MaskArray, scene: Scene, floor_mm: float) -> MaskArray:
    """Return the mask (h, w) with its outline by its own colours against those around it.

    Contrast counts along the difference of both, which no pattern of the support has.
    """
    window = window_around(mask, round((MARGIN_MM + GROWTH_MM) / scene.pixel_mm))
    image = np.ascontiguousarray(scene.image_bgr[window])
    lab, bins, shaded = lab_bytes(image), byte_bins(image), shaded_bins(image)
    taken = others[window] | scene.is_ignored[window]
    place = _signed_depth_px(mask[window]) * scene.pixel_mm
    is_never = taken | (place < -GROWTH_MM)
    place = np.clip(place / PLACE_MM, *PLACE_NATS)
    # A side in shade looks like the shaded support; where a fine window saw that it is raised, it stays.
    height = np.nan_to_num(scene.height_mm[window], nan=-99.0)
    is_raised = (height > floor_mm + RAISED_MM) & (scene.reach_px[window] < FINE_REACH_PX)
    place += np.where(is_raised & mask[window], RAISED_NATS, 0.0)
    food = mask[window]
    for _ in range(ROUNDS):
        depth = _signed_depth_px(food)
        inner = depth > min(INNER_PX, 0.5 * float(depth.max()))
        outer = (depth < -2) & (depth > -MARGIN_MM / scene.pixel_mm) & ~taken
        if not (inner.any() and outer.any()):
            return mask
        around = colour_histogram([bins, *shaded], outer)
        ratio = colour_evidence(colour_histogram([bins], inner), around)[bins]
        features = contrast_features(lab, (inner, outer))
        nothing = np.zeros(food.shape, np.bool_)
        food = cut_in_two((ratio + place).astype(np.float32), features, is_never, nothing)
        if not food.any():
            return mask
    out = np.zeros(mask.shape, np.bool_)
    out[window] = filled(largest_part(food))
    return out


def _is_tidier(own: MaskArray, mask: MaskArray, scene: Scene, floor_mm: float) -> bool:
    """Return whether only small pieces go, or what heights show to be the support, and the outline is more convex."""
    is_support = (np.abs(scene.height_mm - floor_mm) < FLAT_MM) & (scene.reach_px < FINE_REACH_PX)
    lost = largest_part(mask & ~own & ~is_support)
    is_in_pieces = np.count_nonzero(lost) <= MAX_PIECE * np.count_nonzero(mask)
    return bool(is_in_pieces and solidity(own) > solidity(mask) + MORE_SOLID)


def _signed_depth_px(mask: MaskArray) -> Float32Array:
    """Return (H, W) the distance to the outline, px, negative outside."""
    return inward_px(mask, 3) - inward_px(~mask, 3)
