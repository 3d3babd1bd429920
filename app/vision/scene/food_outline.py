"""Each food's outline once more, from its own colours against those just around it.

Masks of foods -> the same, corrected: a hole through which the dish shows, a shadow at the foot, a strip of the dish
that hung on. What all foods together could not tell, one food's colours against its surroundings can.
"""

from collections.abc import Sequence

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
from app.vision.scene.gaps import open_holes
from app.vision.scene.min_cut import cut_in_two
from app.vision.scene.scene import FINE_REACH_PX, Scene

MARGIN_MM = 12.0  # around the mask, whose colours are the surroundings'
GROWTH_MM = 6.0  # by which a mask may grow
INNER_PX = 3.0  # from the outline, within which a mask's colours may be mixed
PLACE_MM = 4.0  # of distance from the former outline that count for one nat
PLACE_NATS = (-2.0, 1.0)
ALIEN_NATS = -0.5  # a pixel inside whose colour speaks so much for the surroundings does not teach the food's colours
MAX_ALIEN_SHARE = 0.25  # of the pixels inside; where more are, food and surroundings look alike
RAISED_MM = 5.0
RAISED_NATS = 1.5
FLAT_MM = 2.5  # about the support: it shows there, whatever its colour
MAX_LOST = 0.07  # of the mask that colours alone may take away: a shadow, a strip of the dish; more is a shaded side
# of its convex hull that the outline fills, where several pieces together may be more
MORE_SOLID = 0.02
ROUNDS = 2


def correct_outlines(masks: Sequence[MaskArray], scene: Scene, floor_mm: float) -> list[MaskArray]:
    """(h, w) masks of the scene's grid, in their order; none of them comes to overlap another.

    floor_mm: of a board over the table, else 0.
    """
    taken = np.zeros(scene.is_ignored.shape, np.uint8)
    for mask in masks:
        taken += mask
    corrected = []
    for mask in masks:
        others = (taken - mask) > 0
        own = _recut(mask, others, scene, floor_mm)
        lost = _lost(mask, own, scene, floor_mm)
        if np.count_nonzero(lost) > MAX_LOST * np.count_nonzero(mask) and not _is_tidied(
            mask, own, lost
        ):
            own = mask
        taken = taken - mask + own
        corrected.append(own)
    return corrected


def tidy_outlines(foods: MaskArray, scene: Scene, floor_mm: float) -> MaskArray:
    """(h, w) all foods, not yet told apart, without checks of a cloth that hung on and would look like notches."""
    tidied = np.zeros(foods.shape, np.bool_)
    for mask in components(foods):
        own = _recut(mask, foods & ~mask, scene, floor_mm, is_by_difference=True)
        tidied |= own if _is_tidied(mask, own, _lost(mask, own, scene, floor_mm)) else mask
    return tidied


def _recut(
    mask: MaskArray,
    others: MaskArray,
    scene: Scene,
    floor_mm: float,
    *,
    is_by_difference: bool = False,
) -> MaskArray:
    """(h, w) the mask's outline by its own colours against those around it.

    is_by_difference: contrast counts along the difference of both, which no pattern of the support has; without it,
    along the most chroma of all, to which a pack's prints belong but not its grey sides.
    """
    margin = round((MARGIN_MM + GROWTH_MM) / scene.pixel_mm)
    if not mask.any():
        return mask
    window = window_around(mask, margin)
    image = np.ascontiguousarray(scene.image_bgr[window])
    lab = lab_bytes(image)
    bins = byte_bins(image)
    shaded = shaded_bins(image)
    is_never = others[window] | scene.is_ignored[window]
    place = _signed_depth_px(mask[window]) * scene.pixel_mm
    is_never |= place < -GROWTH_MM
    place = np.clip(place / PLACE_MM, *PLACE_NATS)
    # A side in shade looks like the shaded support; where a fine window saw that it is raised, it stays.
    height = np.nan_to_num(scene.height_mm[window], nan=-99.0)
    is_raised = (height > floor_mm + RAISED_MM) & (scene.reach_px[window] < FINE_REACH_PX)
    place += np.where(is_raised & mask[window], RAISED_NATS, 0.0)
    food = mask[window]
    nothing = np.zeros(food.shape, np.bool_)
    for _ in range(ROUNDS):
        depth = _signed_depth_px(food)
        inner = depth > min(INNER_PX, 0.5 * float(depth.max()))
        outer = (
            (depth < -2)
            & (depth > -MARGIN_MM / scene.pixel_mm)
            & ~others[window]
            & ~scene.is_ignored[window]
        )
        if not (inner.any() and outer.any()):
            return mask
        around = colour_histogram([bins, *shaded], outer)
        ratio = colour_evidence(colour_histogram([bins], inner), around)[bins]
        is_alien = inner & (ratio < ALIEN_NATS)
        if np.count_nonzero(is_alien) < MAX_ALIEN_SHARE * np.count_nonzero(inner):
            ratio = colour_evidence(colour_histogram([bins], inner & ~is_alien), around)[bins]
        features = contrast_features(lab, (inner, outer) if is_by_difference else None)
        food = cut_in_two((ratio + place).astype(np.float32), features, is_never, nothing)
        if not food.any():
            return mask
    out = np.zeros(mask.shape, np.bool_)
    own = largest_part(food)
    out[window] = filled(own) & ~open_holes(own, scene.height_mm[window], scene.pixel_mm)
    return out


def _lost(mask: MaskArray, corrected: MaskArray, scene: Scene, floor_mm: float) -> MaskArray:
    """(h, w) what a correction takes away by colour alone, where no height says that it is the support, nor a hole.

    Without heights a hole is known by its colour alone, as all else is.
    """
    is_support = (np.abs(scene.height_mm - floor_mm) < FLAT_MM) & (scene.reach_px < FINE_REACH_PX)
    kept = filled(corrected) if np.isfinite(scene.height_mm[corrected]).any() else corrected
    return np.asarray(mask & ~kept & ~is_support, np.bool_)


def _is_tidied(mask: MaskArray, corrected: MaskArray, lost: MaskArray) -> bool:
    """Whether small pieces go, without which the outline is more convex: checks of a cloth that hung on all around."""
    is_in_pieces = np.count_nonzero(largest_part(lost)) <= MAX_LOST * np.count_nonzero(mask)
    return bool(is_in_pieces and solidity(corrected) > solidity(mask) + MORE_SOLID)


def _signed_depth_px(mask: MaskArray) -> Float32Array:
    """(H, W) distance to the outline, px, negative outside."""
    return inward_px(mask, 3) - inward_px(~mask, 3)
