"""Which pixels are food, first version: what stands on the support beside the marker, by height, then colour.

Points of the rectified first view and its colours, hints -> a mask a food on the same grid. Nothing is assumed about
the dish: a rim is told from food by its colour, which is that of the plate's flat part, and by enclosing nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import Failure
from app.vision.model import Float32Array, ImageArray, MaskArray

RAISED_MM = 7.0  # over the marker's plane: table, sheet and flat plates lie below
FLAT_MM = 3.0  # lower is table, shadow or the flat part of a plate, whatever its colour
SURE_MM = 20.0  # no plate's rim and no bread board reaches it
SOLID_SHARE = 0.75  # of its convex hull that a low raised blob must fill to be more than a rim
MIN_AREA_MM2 = 250.0  # seen from above the camera: smaller than a cherry tomato is clutter
MIN_SOLIDITY = 0.5  # a mask that fills less of its convex hull is a rim or an arc of it
APPENDAGE_SHARE = 0.3  # of the greatest inscribed circle's diameter: thinner strips are no part of the food
CELL_MM = 4.0  # of the view from above, in which parts that lie apart are told; a closing bridges two of them
MIN_DENSITY = 0.15  # of the points that a cell facing the camera would show
MAX_CELLS = 500
FOOT_MM = 5.0  # around what is surely food, in which what is raised is thought food, until colour tells
REACH_MM = 45.0  # around what is surely food, beyond which nothing is food: a mound's foot at 25 degrees
MARGIN_MM = 8.0  # around what is raised, beyond which nothing is food
FATTENING_PX = 18.0  # half a coarse window: by so much a food's height spreads over plain surroundings
GRABCUT_SIDE_PX = 360
GRABCUT_ROUNDS = 4
MIN_SEEDS = 30  # pixels; the colour models have five components
CROP_MARGIN_PX = 20


@dataclass(frozen=True, slots=True)
class Region:
    """One food's mask on the rectified grid, (H, W), and the hint that it answers."""

    mask: MaskArray
    hint: int | None = None


@dataclass(frozen=True, slots=True)
class HintMask:
    """A hint drawn on the rectified grid. index: into the hints. is_exact: the mask is the food (polygon).

    is_box: the food lies within the mask; otherwise the mask (a point) lies within the food.
    """

    mask: MaskArray
    index: int
    is_exact: bool = False
    is_box: bool = False


def segment_foods(
    image_bgr: ImageArray,
    points_table: Float32Array,
    pixel_mm: float,
    ignored: MaskArray,
    hints: Sequence[HintMask] = (),
) -> list[Region] | Failure:
    """Foods in the order of their size, those of hints first. image_bgr: (H, W, 3). points_table: (H, W, 3) mm, NaN.

    pixel_mm: what a pixel spans on the support, mm. ignored: (H, W) marker sheet and what is not seen. With hints only
    what they point at is returned. Failure "no_food_found".
    """
    height_mm = points_table[..., 2]
    regions = [Region(hint.mask, hint.index) for hint in hints if hint.is_exact]
    taken = np.zeros(ignored.shape, np.bool_)
    for region in regions:
        taken |= region.mask
    sought = [hint for hint in hints if not hint.is_exact]
    if sought or not hints:
        food, sure = _food_mask(image_bgr, height_mm, pixel_mm, ignored | taken)
        found = _separate(food, sure, points_table, pixel_mm)
        if hints:
            regions += _pointed_at(found, sought, height_mm)
        else:
            regions = [Region(mask) for mask in found]
    return regions or no_food_found()


def no_food_found() -> Failure:
    """The failure where nothing stands on the support."""
    return Failure(
        "no_food_found",
        "Nothing that stands out from the table or plate could be found beside the marker.",
        "Photograph the meal at a slant of about 45 degrees with the whole plate in both views, or mark the food.",
    )


def _food_mask(
    image_bgr: ImageArray, height_mm: Float32Array, pixel_mm: float, ignored: MaskArray
) -> tuple[MaskArray, MaskArray]:
    """(H, W) all food, and (H, W) what is surely food: GrabCut (Rother et al., 2004) begun from heights."""
    raised = np.nan_to_num(height_mm, nan=-1.0) > RAISED_MM
    raised = _opened(raised & ~ignored, 5)
    sure = _sure_food(raised, height_mm)
    out = np.zeros(raised.shape, np.bool_)
    if not sure.any():
        return out, sure
    distance_mm = pixel_mm * cv2.distanceTransform((~sure).astype(np.uint8), cv2.DIST_L2, 5)
    rows, columns = _crop(distance_mm < REACH_MM)
    window = (slice(*rows), slice(*columns))
    scale = min(1.0, GRABCUT_SIDE_PX / max(rows[1] - rows[0], columns[1] - columns[0]))
    size = (max(8, round((columns[1] - columns[0]) * scale)), max(8, round((rows[1] - rows[0]) * scale)))
    candidate = raised & (distance_mm < REACH_MM)
    labels = np.full(raised.shape, cv2.GC_PR_BGD, np.uint8)
    labels[candidate & (distance_mm < FOOT_MM)] = cv2.GC_PR_FGD
    labels[_core(sure)] = cv2.GC_FGD
    from_candidate_mm = pixel_mm * cv2.distanceTransform((~candidate).astype(np.uint8), cv2.DIST_L2, 5)
    is_flat = np.nan_to_num(height_mm, nan=RAISED_MM) < FLAT_MM
    labels[(from_candidate_mm > MARGIN_MM) | is_flat | ignored] = cv2.GC_BGD
    small = cv2.resize(image_bgr[window], size, interpolation=cv2.INTER_AREA)
    small_labels = cv2.resize(labels[window], size, interpolation=cv2.INTER_NEAREST)
    if np.isin(small_labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).sum() < MIN_SEEDS:
        return out, sure
    cv2.setRNGSeed(0)
    cv2.grabCut(
        small, small_labels, (0, 0, 1, 1), np.zeros((1, 65)), np.zeros((1, 65)), GRABCUT_ROUNDS, cv2.GC_INIT_WITH_MASK
    )
    food = np.isin(small_labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32)
    big = cv2.resize(food, (columns[1] - columns[0], rows[1] - rows[0]), interpolation=cv2.INTER_LINEAR)
    out[window] = big > 0.5
    return _opened(out & ~ignored, 7), sure


def _sure_food(raised: MaskArray, height_mm: Float32Array) -> MaskArray:
    """(H, W) what is higher than any rim, and low blobs that are solid."""
    sure = raised & (np.nan_to_num(height_mm, nan=-1.0) > SURE_MM)
    count, labels = cv2.connectedComponents(raised.astype(np.uint8))
    for label in range(1, count):
        blob = labels == label
        if (sure & blob).any():
            continue
        if _solidity(blob) > SOLID_SHARE:
            sure |= blob
    return sure


def _separate(food: MaskArray, sure: MaskArray, points_table: Float32Array, pixel_mm: float) -> list[MaskArray]:
    """Masks that hang together in the photograph and on the table, largest first.

    A rim behind a tall food touches it in the photograph but stands apart on the table, seen from above; so do two
    foods one behind the other. What holds no pixel that is surely food is dropped, and so is clutter.
    """
    count, labels = cv2.connectedComponents(food.astype(np.uint8))
    masks = []
    for label in range(1, count):
        mask = labels == label
        parts = _split_from_above(mask, points_table, pixel_mm)
        for part in range(1, int(parts.max()) + 1):
            piece = parts == part
            if np.count_nonzero(piece & sure) < MIN_SEEDS:
                continue
            piece = _without_appendages(piece)
            if np.count_nonzero(piece) * pixel_mm**2 >= MIN_AREA_MM2 and _solidity(piece) >= MIN_SOLIDITY:
                masks.append(piece)
    return sorted(masks, key=lambda mask: -int(np.count_nonzero(mask)))


def _without_appendages(mask: MaskArray) -> MaskArray:
    """The largest piece of the mask once strips much thinner than its body, such as a bit of rim, are cut off."""
    body = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    opened = _opened(mask, max(3, int(APPENDAGE_SHARE * 2 * float(body.max())) | 1))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened.astype(np.uint8))
    if count < 2:
        return mask
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()), np.bool_)


def _solidity(mask: MaskArray) -> float:
    """Share of its outline's convex hull that the mask fills; a rim, even a closed one, fills little."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=len)
    hull = float(cv2.contourArea(cv2.convexHull(contour)))
    return np.count_nonzero(mask) / hull if hull > 0 else 0.0


def _split_from_above(mask: MaskArray, points_table: Float32Array, pixel_mm: float) -> NDArray[np.int32]:
    """(H, W) number of the part that each pixel of the mask belongs to, 0 outside; parts lie apart on the table.

    Unmeasured pixels go with the nearest measured one.
    """
    inside = mask & (np.nan_to_num(points_table[..., 2], nan=-1.0) > FLAT_MM)
    parts = mask.astype(np.int32)
    if not inside.any():
        return parts
    xy = points_table[inside][:, :2]
    cells = np.floor((xy - xy.min(axis=0)) / CELL_MM).astype(np.int64) + 2
    shape = cells.max(axis=0) + 3
    if int(shape.max()) > MAX_CELLS:  # stray depths; nothing to be learned from above
        return parts
    counts = np.zeros((int(shape[1]), int(shape[0])), np.float32)
    np.add.at(counts, (cells[:, 1], cells[:, 0]), 1.0)
    occupied = (counts >= MIN_DENSITY * (CELL_MM / pixel_mm) ** 2).astype(np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    solid = cv2.morphologyEx(cv2.morphologyEx(occupied, cv2.MORPH_CLOSE, kernel), cv2.MORPH_OPEN, kernel)
    _, above = cv2.connectedComponents(solid)
    grown = cv2.dilate(above.astype(np.float32), kernel).astype(np.int32)  # what the opening took from the border
    above = np.where(above > 0, above, grown)
    found = np.full(mask.shape, -1, np.int32)  # not measured: goes with the nearest
    found[inside] = above[cells[:, 1], cells[:, 0]]  # 0: measured, and no part of anything solid
    known = found >= 0
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    part_of = np.zeros(int(nearest.max()) + 1, np.int32)
    part_of[nearest[known]] = found[known]
    return np.where(mask, part_of[nearest], 0).astype(np.int32)


def _pointed_at(found: list[MaskArray], hints: Sequence[HintMask], height_mm: Float32Array) -> list[Region]:
    """For each hint the found mask that it overlaps most, cut to the hint's box.

    Several hints in one mask share it by nearness. A box in which nothing was found gives what is raised in it.
    """
    chosen: dict[int, int] = {}
    for place, hint in enumerate(hints):
        overlaps = [int(np.count_nonzero(mask & hint.mask)) for mask in found]
        if overlaps and max(overlaps) > 0:
            chosen[place] = int(np.argmax(overlaps))
    regions = []
    for place, hint in enumerate(hints):
        if place not in chosen:
            mask = _opened(hint.mask & (np.nan_to_num(height_mm, nan=-1.0) > FLAT_MM), 7)
        else:
            mask = found[chosen[place]]
            own = _distance_to(hint.mask)
            for rival in (other for other, its in chosen.items() if its == chosen[place] and other != place):
                theirs = _distance_to(hints[rival].mask)
                mask = mask & ((own < theirs) | ((own == theirs) & (place < rival)))
        if hint.is_box:
            mask = mask & hint.mask
        if mask.any():
            regions.append(Region(mask, hint.index))
    return regions


def _distance_to(mask: MaskArray) -> NDArray[np.float32]:
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _crop(mask: MaskArray) -> tuple[tuple[int, int], tuple[int, int]]:
    """Rows and columns (from, to) around the mask with a margin, in which the background's colours are known."""
    limits = []
    for axis in (1, 0):
        where = np.flatnonzero(mask.any(axis=axis))
        limits.append(
            (max(0, int(where[0]) - CROP_MARGIN_PX), min(mask.shape[1 - axis], int(where[-1]) + 1 + CROP_MARGIN_PX))
        )
    return limits[0], limits[1]


def _opened(mask: MaskArray, size_px: int) -> MaskArray:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size_px, size_px))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0


def _core(mask: MaskArray) -> MaskArray:
    """The mask without what may be spread height, of each component at least its inner half."""
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    count, labels = cv2.connectedComponents(mask.astype(np.uint8))
    core = np.zeros(mask.shape, np.bool_)
    for label in range(1, count):
        inside = labels == label
        core |= inside & (depth > min(FATTENING_PX, 0.5 * float(depth[inside].max())))
    return core
