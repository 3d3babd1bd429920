"""The sides of what has a flat top: they stand upright on the support, whatever their shade or print.

A mask with level heights -> the same with the side that the camera sees below the top. Seen from above a slant, the
side of a pack or slice is plain and in shade, so that neither heights nor colours show it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.geometry.masks import (
    closed,
    distance_px,
    eroded,
    inward_px,
    largest_part,
    opened,
    window_around,
)
from app.vision.geometry.pictures import sampled
from app.vision.model import Float32Array, MaskArray
from app.vision.scene.scene import FINE_REACH_PX, Scene, commonest

LEVEL_MM = 3.0  # about a flat top's height
LEVEL_SHARE = 0.65  # of what is measured of a top, that lies at its level
BESIDE_LEVEL_PX = 8  # from what is at the level: unmeasured parts of a plain top
# of a mask by the top and an upright side below it; a dome's top explains less
EXPLAINED_SHARE = 0.8
WINDOW_PX = 5  # by which windows widen a top
AROUND_SHARE, SPECK_PX = 0.8, 3  # of a mask by the hull of all that lies at its level, specks apart
MIN_SIDE_SHARE = 0.15  # of a mask: a smaller side is the outline's own doubt
MIN_HEIGHT_MM = 8.0  # over the support; a lower side is no wider than an outline is unsure
MIN_TOP_MM2 = 400.0
STEP_MM = 3.0  # of height, at which the top is carried down
CELL_MM = 2.0  # of the top seen from above
MARGIN_CELLS = 12
FAR_MM = 100.0
MAX_HIGHER_SHARE = 0.15  # of what is measured in a mask: more, and something else stands there
FLAT_MM = 2.5  # about the support: it shows there
MAX_FLAT_SHARE = 0.3  # of the side that shows the support: more, and the top overhangs


@dataclass(frozen=True, slots=True)
class FlatTop:
    """level_mm: over the table. below: (h, w) the mask with what an upright side below its top would cover.

    The mask alone where the support shows there: it has its side already, or its top overhangs.
    """

    level_mm: float
    below: MaskArray


def with_sides(masks: Sequence[MaskArray], scene: Scene, floor_mm: float) -> list[MaskArray]:
    """The masks (h, w), each flat top with the side below it, the highest first."""
    tops = [flat_top(mask, scene, floor_mm) for mask in masks]
    pairs = sorted(
        zip(masks, tops, strict=True), key=lambda pair: -pair[1].level_mm if pair[1] else 0.0
    )
    taken = np.any([np.zeros(scene.is_ignored.shape, np.bool_), *masks], axis=0)
    out: list[MaskArray] = []
    for mask, top in pairs:
        side = np.zeros_like(taken) if top is None else top.below & ~taken & ~scene.is_ignored
        is_side = np.count_nonzero(side) > MIN_SIDE_SHARE * np.count_nonzero(mask)
        own = mask | side if is_side else mask
        taken |= own
        out.append(own)
    return out


def flat_top(mask: MaskArray, scene: Scene, floor_mm: float) -> FlatTop | None:
    """The flat top of a mask (h, w); None for what is round, low or hardly measured. floor_mm: over the table."""
    heights = scene.height_mm[mask]
    heights = heights[np.isfinite(heights) & (heights > floor_mm + FLAT_MM)]
    if len(heights) * scene.pixel_mm**2 < MIN_TOP_MM2:
        return None
    level = commonest(heights, 2 * LEVEL_MM)
    is_higher = np.count_nonzero(heights > level + LEVEL_MM) > MAX_HIGHER_SHARE * len(heights)
    if level - floor_mm < MIN_HEIGHT_MM or is_higher:
        return None
    top = _top(mask, scene, level)
    if top is None:
        return None
    below = _Footprint(top, scene, level).carried_down(scene, level, floor_mm)
    side = below & ~mask
    if np.count_nonzero(mask & below) < EXPLAINED_SHARE * np.count_nonzero(mask):
        return None
    is_flat = (np.abs(scene.height_mm - floor_mm) < FLAT_MM) & (scene.reach_px < FINE_REACH_PX)
    is_complete = np.count_nonzero(side & is_flat) > MAX_FLAT_SHARE * np.count_nonzero(side)
    return FlatTop(level, mask if is_complete else largest_part(below | mask))


def _top(mask: MaskArray, scene: Scene, level_mm: float) -> MaskArray | None:
    """(h, w) the convex part of a mask that lies at a level or was not measured; None if too little is at the level."""
    at_level = np.abs(scene.height_mm - level_mm) < LEVEL_MM
    is_beside = distance_px(at_level & mask) < BESIDE_LEVEL_PX
    possible = opened(mask & (at_level | (is_beside & ~np.isfinite(scene.height_mm))), WINDOW_PX)
    inner = eroded(possible, WINDOW_PX)
    top = _hull(inner) & mask
    # A plain top, blown out by the light, is measured along its edge and here and there.
    around = _hull_of_all(opened(mask & at_level, SPECK_PX)) & mask
    if np.count_nonzero(around) > AROUND_SHARE * np.count_nonzero(mask):
        top = around
    level = np.count_nonzero(top & at_level)
    measured = np.count_nonzero(top & np.isfinite(scene.height_mm))
    is_large = np.count_nonzero(top) * scene.pixel_mm**2 >= MIN_TOP_MM2
    return top if is_large and level >= LEVEL_SHARE * measured else None


def _hull(mask: MaskArray) -> MaskArray:
    """The convex hull of the largest part."""
    return _hull_of_all(largest_part(mask))


def _hull_of_all(mask: MaskArray) -> MaskArray:
    contours, _ = cv2.findContours(
        mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    out = np.zeros(mask.shape, np.uint8)
    if contours:
        cv2.fillConvexPoly(out, cv2.convexHull(np.concatenate(contours)), 1)
    return out > 0


class _Footprint:
    """A flat top seen from above, on a grid of CELL_MM."""

    def __init__(self, top: MaskArray, scene: Scene, level_mm: float) -> None:
        window = window_around(top, 0)
        places = scene.xy_at(level_mm, window)[top[window]]
        self._low = places.min(axis=0) - MARGIN_CELLS * CELL_MM
        columns, rows = (
            np.ceil((places.max(axis=0) - self._low) / CELL_MM).astype(int) + MARGIN_CELLS
        )
        self._high = self._low + CELL_MM * np.array([columns, rows])
        cells = np.zeros((int(rows), int(columns)), np.bool_)
        column, row = ((places - self._low) / CELL_MM).astype(int).T
        cells[row, column] = True
        self._outside_mm = inward_px(~closed(cells, 3)) * CELL_MM

    def outside_mm(self, xy_mm: Float32Array) -> Float32Array:
        """(h, w) distance from the footprint, 0 within it, at (h, w, 2); FAR_MM where it is far or not known."""
        cells = np.nan_to_num((xy_mm - self._low) / CELL_MM - 0.5, nan=-1e4).astype(np.float32)
        return sampled(self._outside_mm, cells, beyond=FAR_MM)

    def carried_down(self, scene: Scene, level_mm: float, floor_mm: float) -> MaskArray:
        """(h, w) pixels whose rays pass below the top, anywhere between its level and the floor."""
        out = np.zeros(scene.is_ignored.shape, np.bool_)
        near = self._rays_near(scene, level_mm, floor_mm)
        if not near.any():
            return out
        window = window_around(near, 0)
        for height in np.linspace(
            floor_mm, level_mm, max(2, int((level_mm - floor_mm) / STEP_MM) + 1)
        ):
            out[window] |= self.outside_mm(scene.xy_at(float(height), window)) < CELL_MM / 2
        return out

    def _rays_near(self, scene: Scene, level_mm: float, floor_mm: float) -> MaskArray:
        """Return the pixels (h, w) whose rays may cross the footprint's grid between two heights."""
        at_floor, at_level = scene.xy_at(floor_mm), scene.xy_at(level_mm)
        may_cross = (np.minimum(at_floor, at_level) <= self._high) & (
            np.maximum(at_floor, at_level) >= self._low
        )
        return np.asarray(may_cross.all(axis=-1), np.bool_)
