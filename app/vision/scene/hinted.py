"""Food where a person says it is: a point lies within it, a box bounds it.

Hints drawn on the scene's grid and the foods that were found without them -> one mask per hint. Where no food was
found, or one that does not fit the box, it is cut out by its colours against those around the box; a box is drawn
tightly, so that its food reaches from side to side (Lempitsky et al., "Image segmentation with a bounding box prior",
ICCV 2009).
"""

from collections.abc import Sequence

import cv2
import numpy as np

from app.vision.geometry.masks import dilated
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.cut_out import BIAS_NATS, MAX_BIASES, cut_around, cut_out, palette_of
from app.vision.scene.foods_apart import divide
from app.vision.scene.places import Place
from app.vision.scene.scene import FINE_REACH_PX, Scene

BOX_IOU = 0.6  # of a found food's own box with a person's, from which on they mean the same
INSIDE_SHARE = 0.85  # of a found food that must lie within the box
SPAN = 0.85  # of the box's sides, which its food reaches across
AROUND_SHARE = 0.2  # of the box's sides: the margin whose colours are the surroundings'
# of a box, to learn the food's colours there rather than in the box's middle
MIN_RAISED_SHARE = 0.15
CORE_SHARE = 0.6  # of the box's sides: the ellipse in its middle
FLAT_MM = 2.5
RAISED_NATS, FLAT_NATS = 2.0, -3.0


def hinted_masks(
    hints: Sequence[MaskArray],
    is_box: Sequence[bool],
    found_masks: Sequence[MaskArray],
    scene: Scene,
    places: Sequence[Place],
) -> list[MaskArray]:
    """(h, w) masks in the order of the hints; they do not overlap. found: foods without hints.

    Several points in one food share it.
    """
    masks: list[MaskArray | None] = [None] * len(hints)
    shared: dict[int, list[int]] = {}
    for number, hint in enumerate(hints):
        fits = [
            _fit(mask, hint) if is_box[number] else float(np.count_nonzero(mask & hint))
            for mask in found_masks
        ]
        if fits and max(fits) > 0:
            shared.setdefault(int(np.argmax(fits)), []).append(number)
    for which, numbers in shared.items():
        parts = (
            divide(found_masks[which], [hints[k] for k in numbers], scene)
            if len(numbers) > 1
            else [found_masks[which]]
        )
        for number, part in zip(numbers, parts, strict=True):
            masks[number] = part & hints[number] if is_box[number] else part
    taken = np.zeros(scene.is_ignored.shape, np.bool_)
    for mask in masks:
        taken |= mask if mask is not None else False
    out = []
    for number, mask in enumerate(masks):
        if mask is not None:
            out.append(mask)
        elif is_box[number]:
            out.append(_in_box(hints[number], found_masks, taken, scene, places))
        else:
            out.append(cut_around(hints[number], taken, scene, _height_nats(scene, places)))
        taken |= out[-1]
    return out


def _fit(mask: MaskArray, box: MaskArray) -> float:
    """How well a found food fits a person's box, 0 to 1; 0 where it is another food or only a part."""
    area = np.count_nonzero(mask)
    if area == 0 or np.count_nonzero(mask & box) < INSIDE_SHARE * area:
        return 0.0
    (x, y, width, height), (bx, by, box_width, box_height) = (
        cv2.boundingRect(each.astype(np.uint8)) for each in (mask, box)
    )
    across = max(0, min(x + width, bx + box_width) - max(x, bx))
    down = max(0, min(y + height, by + box_height) - max(y, by))
    overlap = across * down / (width * height + box_width * box_height - across * down)
    return float(overlap) if overlap >= BOX_IOU else 0.0


def _in_box(
    box: MaskArray,
    masks: Sequence[MaskArray],
    taken: MaskArray,
    scene: Scene,
    places: Sequence[Place],
) -> MaskArray:
    """The food that spans a box; else what the box cuts out of a larger food that was found."""
    mask, spans = _cut_in_box(box, taken, scene, places)
    if spans:
        return mask
    larger = (
        food & box
        for food in masks
        if np.count_nonzero(food & box) > INSIDE_SHARE * np.count_nonzero(box)
    )
    return next(larger, mask)


def _cut_in_box(
    box: MaskArray, taken: MaskArray, scene: Scene, places: Sequence[Place]
) -> tuple[MaskArray, bool]:
    """What stands out in a box, and whether it spans the box. taken: (h, w) other foods."""
    x, y, width, height = cv2.boundingRect(box.astype(np.uint8))
    margin = max(3, round(AROUND_SHARE * max(width, height)))
    allowed = box & ~taken & ~scene.is_ignored
    around = dilated(box, 2 * margin + 1) & ~box & ~taken & ~scene.is_ignored
    core = np.zeros(box.shape, np.uint8)
    middle = (x + width // 2, y + height // 2)
    axes = (max(1, round(CORE_SHARE * width / 2)), max(1, round(CORE_SHARE * height / 2)))
    cv2.ellipse(core, middle, axes, 0.0, 0.0, 360.0, (1.0,), -1)
    raised = _raised(places, box.shape) & allowed
    is_known = np.count_nonzero(raised) > MIN_RAISED_SHARE * np.count_nonzero(box)
    food = raised if is_known else (core > 0) & allowed
    mask, evidence, palette = food, _height_nats(scene, places), palette_of(scene.image_bgr)
    for step in range(MAX_BIASES):
        mask = cut_out(food, around, allowed, palette, evidence, step * BIAS_NATS)
        _, _, across, down = cv2.boundingRect(mask.astype(np.uint8))
        if across >= SPAN * width and down >= SPAN * height:
            return mask, True
    return mask, False


def _height_nats(scene: Scene, places: Sequence[Place]) -> Float32Array:
    """(h, w) what heights say for food."""
    floors = {0.0, *(place.floor_mm for place in places)}
    is_flat = np.any(
        [np.abs(scene.height_mm - np.float32(floor)) < FLAT_MM for floor in floors], axis=0
    )
    is_flat &= scene.reach_px < FINE_REACH_PX
    raised = _raised(places, scene.is_ignored.shape)
    return np.where(raised, RAISED_NATS, np.where(is_flat, FLAT_NATS, 0.0)).astype(np.float32)


def _raised(places: Sequence[Place], shape: tuple[int, ...]) -> MaskArray:
    raised = np.zeros(shape, np.bool_)
    for place in places:
        raised |= place.is_sure
    return raised
