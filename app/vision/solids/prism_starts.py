"""Where prisms begin: footprints and heights whose silhouette is the food's, by its outline alone and by its points.

A prism's silhouette is the union of its top and its walls. So every height gives a footprint, what the outline's hull
covers both when cast onto the support and onto the top; the height that is right gives the hull back. A face on which
nothing can be matched, white on white, has a height by this all the same.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from app.vision.model import Float64Array, MaskArray
from app.vision.solids.prism import Prism, prism
from app.vision.views.sight import Sight

MIN_SOLIDITY = 0.85  # a mask that fills less of its hull is no prism's
# of the silhouettes (intersection over union): less, and the family is not tried
MIN_LIKENESS = 0.85
HEIGHT_RATIOS = np.geomspace(0.5, 2.0, 15)  # of the points' height
MIN_HEIGHT_MM = 5.0
CAMERA_SHARE = 0.8  # of the camera's height, up to which a food may reach
MIN_SIDE_MM = 6.0
# OpenCV's minEnclosingTriangle raises on corners that lie closer than float32 resolves
SAME_POINT_MM = 0.2


@dataclass(frozen=True, slots=True)
class _Candidate:
    """polygon: (n, 2) mm, counter-clockwise. likeness: of the silhouettes, 0 to 1."""

    height_mm: float
    polygon: Float64Array
    likeness: float


def begin_prisms(
    sight: Sight, mask: MaskArray, height_mm: float, support_mm: float, support_sd_mm: float
) -> list[Prism]:
    """Blocks and wedges to try, at most two each: with the points' height, and with the outline's.

    mask: (H, W) in the first view. height_mm: of the points over the support.
    """
    hull = _hull(mask)
    if hull is None:
        return []
    out = []
    for name, footprint in (("block", _rectangle), ("wedge", enclosing_triangle)):
        candidates = [
            _candidate(sight, hull, footprint, max(ratio * height_mm, MIN_HEIGHT_MM), support_mm)
            for ratio in (1.0, *HEIGHT_RATIOS)
        ]
        usable = [each for each in candidates if each is not None and each.likeness > MIN_LIKENESS]
        if not usable:
            continue
        likest = max(usable, key=lambda each: each.likeness)
        is_of_points = usable[0] is candidates[0]
        chosen = [usable[0], likest] if is_of_points and likest is not usable[0] else [likest]
        out += [
            prism(name, each.polygon, each.height_mm, support_mm, support_sd_mm) for each in chosen
        ]
    return out


def _hull(mask: MaskArray) -> Float64Array | None:
    """(n, 2) px, the mask's convex hull; None where the mask fills too little of it."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = (
        np.concatenate([np.asarray(each).reshape(-1, 2) for each in contours])
        if contours
        else np.empty((0, 2))
    )
    if len(points) < 3:
        return None
    hull = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2)
    area = cv2.contourArea(hull)
    return (
        hull.astype(np.float64)
        if area > 0 and np.count_nonzero(mask) > MIN_SOLIDITY * area
        else None
    )


def _candidate(
    sight: Sight,
    hull: Float64Array,
    footprint: Callable[[Float64Array], Float64Array | None],
    height_mm: float,
    support_mm: float,
) -> _Candidate | None:
    camera = sight.cameras_mm[0]
    if height_mm > CAMERA_SHARE * (camera[2] - support_mm):
        return None
    base, top = (cast(sight, hull, support_mm + level) for level in (0.0, height_mm))
    if base is None or top is None:
        return None
    area, both = cv2.intersectConvexConvex(_convex(base), _convex(top))
    if area <= 0:
        return None
    polygon = footprint(np.asarray(both, np.float64).reshape(-1, 2))
    if polygon is None:
        return None
    corners = np.concatenate(
        [
            np.column_stack([polygon, np.full(len(polygon), support_mm + level)])
            for level in (0.0, height_mm)
        ]
    )
    silhouette = _convex(sight.project(corners)[0])
    shared, _ = cv2.intersectConvexConvex(silhouette, _convex(hull))
    union = cv2.contourArea(silhouette) + cv2.contourArea(_convex(hull)) - shared
    return _Candidate(height_mm, polygon, float(shared / union))


def cast(sight: Sight, pixels: Float64Array, level_mm: float) -> Float64Array | None:
    """Return (n, 2) mm, where the rays through pixels of the first view meet a level; None where one does not."""
    pair = sight.pair
    rays = pair.rays(pixels) @ pair.rotation
    if (rays[:, 2] >= 0).any():
        return None
    camera = sight.cameras_mm[0]
    return np.asarray(
        (camera + rays * ((level_mm - camera[2]) / rays[:, 2])[:, None])[:, :2], np.float64
    )


def _rectangle(footprint: Float64Array) -> Float64Array | None:
    middle, size, angle = cv2.minAreaRect(footprint.astype(np.float32))
    if min(size) < MIN_SIDE_MM:
        return None
    return _counter_clockwise(np.asarray(cv2.boxPoints((middle, size, angle)), np.float64))


def enclosing_triangle(footprint: Float64Array) -> Float64Array | None:
    """(3, 2) the least triangle around a convex footprint, counter-clockwise; None where a side is too short."""
    middle = footprint.mean(axis=0)
    outline = cv2.approxPolyDP((footprint - middle).astype(np.float32), SAME_POINT_MM, closed=True)
    if len(outline) < 3:
        return None
    _, corners = cv2.minEnclosingTriangle(outline.reshape(-1, 1, 2))
    triangle = np.asarray([] if corners is None else corners, np.float64).reshape(-1, 2) + middle
    if len(triangle) < 3:
        return None
    sides = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1)
    return _counter_clockwise(triangle) if sides.min() > MIN_SIDE_MM else None


def _counter_clockwise(polygon: Float64Array) -> Float64Array:
    following = np.roll(polygon, -1, axis=0)
    area = (polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]).sum()
    return polygon if area > 0 else polygon[::-1]


def _convex(points: Float64Array) -> cv2.typing.MatLike:
    return cv2.convexHull(points.astype(np.float32))
