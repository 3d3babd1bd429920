"""Which pixels are food at all: heights over table and dish first, then colour and texture, by a minimum cut.

The dish and the table lend their colours from where geometry is sure of them, the food from where it stands higher
than any rim; both colour models are then learned anew from the cut. Nothing is known beforehand of any food or dish.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.masks import (
    closed,
    components,
    distance_px,
    inward_px,
    resized,
    touching,
    window_around,
)
from app.vision.geometry.pictures import lab_bytes
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.colour_bins import (
    byte_bins,
    colour_histogram,
    contrast_features,
    shaded_bins,
)
from app.vision.scene.gaps import find_gaps
from app.vision.scene.min_cut import cut_in_two, is_settled
from app.vision.scene.places import OVER_RIM_MM, UNMEASURED_MM, Place
from app.vision.scene.scene import FINE_REACH_PX, Scene

FLAT_MM = 2.5  # lower is table, sheet or a dish's floor
# this far (and two windows) within its outline, a raised part is food whatever its colour
SURE_DEPTH_MM = 8.0
JOINED_PX = 15  # across what is unmeasured within what stands
SIDE_PX = 360
MARGIN_PX = 12
ROUNDS = 3
COLOUR_LIMIT_NATS = 4.0
# of colour and texture, over which they confirm what is raised; below, heights alone tell
ALIKE_NATS = 2.0
TEXTURE_LIMIT_NATS = 2.0
HEIGHT_LIMIT_NATS = (-4.0, 3.0)
UNSEEN = 6e-6  # probability of a colour that a model has not seen


@dataclass(frozen=True, slots=True)
class FoodPixels:
    """Masks of the scene's grid, (h, w).

    is_core: parts that geometry alone calls food. is_gap: parts of is_food through which the support shows after all;
    they stay in it, for foods are told apart by their outer outlines.
    """

    is_food: MaskArray
    is_core: MaskArray
    is_gap: MaskArray


def find_food_pixels(scene: Scene, place: Place) -> FoodPixels:
    """All food of a place, not yet told apart."""
    sure = place.is_sure
    core, deep = _cores(sure, scene, is_on_board=place.floor_mm > 0)
    return _cut(replace(scene, is_ignored=scene.is_ignored | place.is_elsewhere), place, core, deep)


def _cut(scene: Scene, place: Place, whole_core: MaskArray, whole_deep: MaskArray) -> FoodPixels:
    tall = np.nan_to_num(
        np.where(scene.is_ignored, np.float32(np.nan), scene.height_mm), nan=UNMEASURED_MM
    )
    # Within it the background's colours are known.
    window = window_around(place.may_be_food, MARGIN_PX)
    shape = place.may_be_food[window].shape[::-1]
    scale = min(1.0, SIDE_PX / max(shape))
    size = (max(8, round(shape[0] * scale)), max(8, round(shape[1] * scale)))
    roi, band, sure, core, deep = (
        resized(mask[window], size)
        for mask in (place.may_be_food, place.shows_dish, place.is_sure, whole_core, whole_deep)
    )
    is_ignored = resized(scene.is_ignored[window], size)
    image = np.asarray(
        cv2.resize(scene.image_bgr[window], size, interpolation=cv2.INTER_AREA), np.uint8
    )
    shaded = shaded_bins(image)
    height = cv2.resize(tall[window], size, interpolation=cv2.INTER_NEAREST)
    is_fine = (
        cv2.resize(scene.reach_px[window], size, interpolation=cv2.INTER_NEAREST) < FINE_REACH_PX
    )
    is_measured = height > -50.0
    is_flat = np.abs(height) < FLAT_MM
    if place.floor_mm > 0:
        is_flat |= np.abs(height - np.float32(place.floor_mm)) < FLAT_MM
    is_flat &= is_fine & is_measured & (distance_px(sure) > 3)
    texture = cv2.resize(scene.texture[window], size, interpolation=cv2.INTER_AREA)
    bins = byte_bins(image)
    texture_bins = np.clip(np.log2(texture + 0.25) * 4 + 8, 0, 31).astype(np.int64)
    features = contrast_features(lab_bytes(image))

    over = is_measured & (height > place.rim_mm + OVER_RIM_MM)
    # A coarse window spreads the height of what it sees over holes and surroundings: it says little of one pixel.
    raised = np.where(is_fine, 4.0 * over + 2.5 * core + 3.0 * sure, 0.7 * over + 0.7 * core)
    evidence = np.clip(raised - 4.0 * is_flat - 0.3 * ~is_measured, *HEIGHT_LIMIT_NATS)

    band &= ~sure
    others = ((~roi & ~is_ignored) | band | is_flat) & ~core
    surely_raised = _surely_raised(core, deep, place)

    def cut(food: MaskArray, others: MaskArray, never: MaskArray) -> tuple[MaskArray, Float32Array]:
        colour = _ratio(
            colour_histogram([bins], food), colour_histogram([bins, *shaded], others), bins
        )
        ratio = np.clip(colour, -COLOUR_LIMIT_NATS, COLOUR_LIMIT_NATS) + _texture_ratio(
            texture_bins, food, others
        )
        is_never = ~roi | is_ignored | never | (band & (ratio < 1.0))
        is_always = deep | (core & (ratio > ALIKE_NATS)) | _alike(surely_raised, ratio)
        return cut_in_two(
            (ratio + evidence).astype(np.float32), features, is_never, is_always
        ), colour

    is_food, colour = cut(core, others, np.zeros_like(core))
    over_floor = np.where(is_measured, height - np.float32(place.floor_mm), np.float32(np.nan))
    gaps = find_gaps(sure, over_floor, colour, scene.pixel_mm / scale)
    for _ in range(ROUNDS - 1):
        food, others = _apart(is_food, is_ignored)
        before = is_food
        if food.any():
            is_food, _ = cut(food, others, np.zeros_like(core))
        if is_settled(is_food, before):
            break
    # Where food and support are alike the cut closes a gap, for its border is longer than the colours are worth.
    gaps &= is_food
    open_found = is_food & ~gaps
    if gaps.any():
        food, others = _apart(open_found, is_ignored)
        open_found, _ = cut(food, others | gaps, gaps)
    gaps = touching(is_food & ~open_found, gaps)
    out = np.zeros(scene.is_ignored.shape, np.bool_)
    out[window] = (
        cv2.resize(is_food.astype(np.float32), shape, interpolation=cv2.INTER_LINEAR) > 0.5
    )
    whole_gaps = np.zeros_like(out)
    whole_gaps[window] = resized(gaps, shape)
    return FoodPixels(out & ~scene.is_ignored, whole_core, whole_gaps)


def _cores(sure: MaskArray, scene: Scene, *, is_on_board: bool) -> tuple[MaskArray, MaskArray]:
    """Return two masks (h, w): the core, and the part of it that is food for certain.

    The core is raised and lies farther from its outline than a window reaches. Around a food on a
    board the board is measured, so that unmeasured pixels within what stands are the food's.
    """
    joined = sure
    if is_on_board:
        joined = closed(sure, JOINED_PX) & (sure | ~np.isfinite(scene.height_mm))
    depth = inward_px(joined, 3)
    reach = np.maximum(np.where(scene.reach_px > FINE_REACH_PX, scene.reach_px, 2.0), 2.0)
    core = joined & (depth > reach + 1)
    deep = sure & (depth > reach + SURE_DEPTH_MM / scene.pixel_mm)
    for part in components(sure):
        if not (core & part).any():
            core |= part & (depth > 0.6 * float(depth[part].max()))
    return core, deep


def _surely_raised(core: MaskArray, deep: MaskArray, place: Place) -> MaskArray:
    """Return the parts of the core (h, w) that heights alone may call food.

    core, deep: (h, w) as _cores returns them

    On a plate, whose floor is not measured, windows spread heights from its rim to its food.
    """
    if place.floor_mm > 0:
        return core
    return touching(core, deep) if place.dish is None else np.zeros_like(core)


def _alike(surely_raised: MaskArray, ratio: Float32Array) -> MaskArray:
    """Return the raised parts (h, w) with the colours of their support, from which only heights part them.

    ratio: (h, w) log likelihood ratio of colour and texture, food over what is around it, nats
    """
    alike = np.zeros_like(surely_raised)
    for part in components(surely_raised):
        if float(np.median(ratio[part])) < ALIKE_NATS:
            alike |= part
    return alike


def _apart(is_food: MaskArray, is_ignored: MaskArray) -> tuple[MaskArray, MaskArray]:
    """What teaches the colours of food and of the rest: either side of the border, without its mixed pixels."""
    return is_food & (distance_px(~is_food) > 2), ~is_food & ~is_ignored & (
        distance_px(is_food) > 2
    )


def _ratio(first: Float32Array, second: Float32Array, bins: NDArray[np.int64]) -> Float32Array:
    return np.log((first + UNSEEN) / (second + UNSEEN))[bins]


def _texture_ratio(bins: NDArray[np.int64], food: MaskArray, others: MaskArray) -> Float32Array:
    smooth = [
        np.convolve(np.bincount(bins[mask], minlength=32), [0.1, 0.2, 0.4, 0.2, 0.1], "same")
        / max(1, mask.sum())
        for mask in (food, others)
    ]
    ratio = np.log((smooth[0] + 0.01) / (smooth[1] + 0.01))[bins]
    return np.asarray(np.clip(ratio, -TEXTURE_LIMIT_NATS, TEXTURE_LIMIT_NATS), np.float32)
