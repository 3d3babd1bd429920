"""Horizontal circles over the table, found by their edges in both views: rims of vessels, surfaces of liquids.

Both rectified views -> circles (centre, radius, height). Dense parallax misses thin rims, glass and mirroring liquids;
their edges do not: seen from above at its own height, a horizontal circle is the same circle in both views.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.pictures import blurred, grey_of, sampled
from app.vision.model import Float32Array, Float64Array, ImageArray, MaskArray
from app.vision.views.rectification import RectifiedPair
from app.vision.views.sight import Sight

CELL_MM = 1.5
REACH_MM = 420.0  # of the searched square, from the middle of what is seen
NEAR_MM = 50.0  # from a camera: nothing that near is in focus
MAX_SHARE_OF_CAMERA_HEIGHT = 0.7  # of a circle's height: higher ones are not seen from above
HEIGHTS_MM = (20.0, 170.0)  # lower circles are plates, saucers and what is printed on them
HEIGHT_STEP_MM = 6.0  # of the search; starts of neighbouring heights reach the same rim
RADII_MM = (24.0, 140.0)
RADIUS_STEP_MM = 2.5
BEYOND_CELLS = math.ceil(RADII_MM[1] / CELL_MM / 2) + 1  # around the searched centres: other votes
SAME_DIRECTION = 0.9  # cosine between the views' gradients at one place
LEAST_STEP = 5.0  # grey levels over a cell, of an edge
MIN_VOTES = 0.22  # of a circle's cells, in the search
KEPT_CIRCLES = 60
TRIED_AT_ONCE = 20  # starts refined together, before it is known which of them others leave out
# x, y, radius, height: starts that near to one that led to a circle are left
NEXT_TO_CIRCLE_MM = (8.0, 8.0, 6.0, 8.0)
# to one that led to none; less than a step of height, for its neighbour may
NEXT_TO_NONE_MM = (5.0, 5.0, 2.0, 5.0)
SAMPLES = 120  # directions of a circle
SEARCH_PX = 5  # across the circle, at most, for its edge
ROUNDS = 6
FINE_SD_PX = 1.0  # of the blur under which edges are measured
RESTARTS_MM = (-6.0, -3.0, 3.0, 6.0)  # of the height
ON_EDGE_PX = 1.2
LEAST_SEEN = 0.3  # of a circle's directions with any edge beside it, in each view: fewer on the way lead to no circle
MIN_COVER = 0.5  # of a circle's directions with an edge on it, in each view


@dataclass(frozen=True, slots=True)
class Circle:
    """centre_mm: (2,) x, y in the table frame; height_mm over the marker's plane.

    cover: share of its directions with an edge on it in the view that shows less of it.
    """

    centre_mm: Float64Array
    radius_mm: float
    height_mm: float
    cover: float

    def ring(self, radius_mm: float, height_mm: float, samples: int = SAMPLES) -> Float64Array:
        """(samples, 3) mm on the circle about the same axis with this radius and height."""
        return circle_points(np.array([*self.centre_mm, radius_mm, height_mm]), samples)


def find_circles(pair: RectifiedPair, sight: Sight, is_usable: MaskArray) -> list[Circle]:
    """Circles parallel to the table, best seen first. is_usable: (H, W) pixels of the first view that may show one."""
    starts = [start for _, start in _candidates(pair, sight, is_usable)]
    fine = smoothed_pair(pair, FINE_SD_PX)
    circles: list[Circle] = []
    tried: list[tuple[Float64Array, tuple[float, ...]]] = []
    ahead: dict[int, Circle | None] = {}  # by place among the starts
    for place, start in enumerate(starts):
        if len(tried) >= KEPT_CIRCLES:
            break
        if any(np.all(np.abs(start - other) < apart) for other, apart in tried):
            continue
        if place not in ahead:
            places = _next_apart(starts, place, tried)
            ahead |= zip(
                places,
                _best_near(sight, fine, np.stack([starts[each] for each in places])),
                strict=True,
            )
        circle = ahead[place]
        tried.append((start, NEXT_TO_NONE_MM if circle is None else NEXT_TO_CIRCLE_MM))
        if circle is not None and not any(_is_same(circle, other) for other in circles):
            circles.append(circle)
    return sorted(circles, key=lambda circle: -circle.cover)


def smoothed_pair(pair: RectifiedPair, sd_px: float) -> list[Float32Array]:
    """(H, W) grey levels of both views under a Gaussian."""
    return [blurred(grey_of(image).astype(np.float32), sd_px) for image in pair.both_bgr]


def _candidates(
    pair: RectifiedPair, sight: Sight, is_usable: MaskArray
) -> list[tuple[float, Float64Array]]:
    """(share of the circle, (x, y, radius, height)) at all heights, the best first."""
    smooth = smoothed_pair(pair, max(0.4 * CELL_MM / pair.pixel_mm, 0.5))
    usable, middle = is_usable.astype(np.uint8), _middle_mm(sight, is_usable)
    candidates: list[tuple[float, Float64Array]] = []
    for height_mm in np.arange(*HEIGHTS_MM, HEIGHT_STEP_MM).tolist():
        if height_mm < MAX_SHARE_OF_CAMERA_HEIGHT * pair.first_centre_mm[2]:
            candidates += _vote(sight, smooth, usable, height_mm, middle)
    return sorted(candidates, key=lambda each: -each[0])


def _next_apart(
    starts: Sequence[Float64Array],
    begin: int,
    tried: Sequence[tuple[Float64Array, tuple[float, ...]]],
) -> list[int]:
    """Places of the next starts, from begin on, that will be tried: they are near none tried, nor one another.

    What one of them leads to may still leave out another.
    """
    places: list[int] = []
    near = [*tried]
    for place in range(begin, len(starts)):
        if len(places) >= TRIED_AT_ONCE:
            break
        if not any(np.all(np.abs(starts[place] - other) < apart) for other, apart in near):
            places.append(place)
            near.append((starts[place], NEXT_TO_NONE_MM))
    return places


def _best_near(sight: Sight, grey: list[Float32Array], starts: Float64Array) -> list[Circle | None]:
    """The best covered circle near each start, (n, 4), from neighbouring heights too: a rim has two edges."""
    circles = refine_circles(sight, grey, starts)
    again = [index for index, circle in enumerate(circles) if circle is not None]
    lifts = np.array([[0.0, 0.0, 0.0, lift] for lift in RESTARTS_MM])
    ends = [np.array([*c.centre_mm, c.radius_mm, c.height_mm]) for c in circles if c is not None]
    others = (
        refine_circles(sight, grey, (np.array(ends)[:, None] + lifts).reshape(-1, 4))
        if ends
        else []
    )
    for turn, index in enumerate(again):
        near = [circles[index], *others[turn * len(lifts) : (turn + 1) * len(lifts)]]
        circles[index] = max(
            (circle for circle in near if circle is not None), key=lambda each: each.cover
        )
    return circles


def _middle_mm(sight: Sight, is_usable: MaskArray) -> Float64Array:
    """(2,) of the table that is seen."""
    pixels = np.argwhere(is_usable[::8, ::8])[:, ::-1].astype(np.float64) * 8
    points = sight.points(pixels, np.zeros(len(pixels)))  # the marker's plane has no parallax
    points = points[np.linalg.norm(points, axis=1) < 2 * REACH_MM]
    return np.median(points[:, :2], axis=0) if len(points) else np.zeros(2)


def _is_same(circle: Circle, other: Circle) -> bool:
    return (
        float(np.linalg.norm(circle.centre_mm - other.centre_mm)) < 3.0
        and abs(circle.radius_mm - other.radius_mm) < 1.5
        and abs(circle.height_mm - other.height_mm) < 3.0
    )


def _vote(
    sight: Sight,
    grey: list[Float32Array],
    usable: ImageArray,
    height_mm: float,
    middle_mm: Float64Array,
) -> list[tuple[float, Float64Array]]:
    """(share of the circle, (x, y, radius, height)) at one height, by the gradients that both views agree on."""
    side = int(2 * REACH_MM / CELL_MM)
    corner_mm = middle_mm - REACH_MM
    # The map is fixed by four places near the middle, which lie before both cameras; cells behind them are left out.
    cells = (side - 1) / 2 + np.array(
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
    ) * NEAR_MM / CELL_MM
    seen_at = sight.project(np.column_stack([cells * CELL_MM + corner_mm, np.full(4, height_mm)]))
    maps = [
        cv2.getPerspectiveTransform(
            cells.astype(np.float32), sight.in_view(*seen_at, view).astype(np.float32)
        )
        for view in (0, 1)
    ]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(
        usable, maps[0], (side, side), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    )
    left, top, width, height = cv2.boundingRect(seen)
    if min(width, height) < 3:
        return []
    cut = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
    seen = cv2.erode(seen[top : top + height, left : left + width], np.ones((3, 3), np.uint8))
    above = [
        np.asarray(
            cv2.warpPerspective(image, matrix @ cut, (width, height), flags=flags), np.float32
        )
        for image, matrix in zip(grey, maps, strict=True)
    ]
    rows, columns, towards = _shared_edges(above, seen > 0)
    rows, columns = rows + top, columns + left
    places = np.column_stack([columns, rows]) * CELL_MM + corner_mm
    forward, camera = sight.pair.rotation[2], sight.pair.first_centre_mm
    before = (places - camera[:2]) @ forward[:2] + (height_mm - camera[2]) * forward[2] > NEAR_MM
    rows, columns = rows[before], columns[before]
    half = side // 2  # centres are counted in cells of twice the width
    wide = half + 2 * BEYOND_CELLS
    one_way = towards[before].T[::-1] / 2
    both_ways = np.hstack([one_way, -one_way]).astype(np.float32)
    edges = np.tile([rows, columns], 2).astype(np.float32) / 2 + BEYOND_CELLS
    out = []
    for radius in np.arange(*RADII_MM, RADIUS_STEP_MM).tolist():
        reach = radius / CELL_MM
        least = MIN_VOTES * 2 * np.pi * reach
        if len(rows) < least:
            break
        in_row, in_column = (edges + np.float32(reach) * both_ways).astype(np.int64)
        if _most_in_blocks(in_row, in_column, wide) < least:
            continue
        votes = np.bincount(in_row * wide + in_column, minlength=wide * wide).reshape(wide, wide)
        votes = votes[BEYOND_CELLS:-BEYOND_CELLS, BEYOND_CELLS:-BEYOND_CELLS]
        share = cv2.blur(votes.astype(np.float32), (3, 3)) * np.float32(9 * MIN_VOTES / least)
        for _ in range(3):
            _, best, _, place = cv2.minMaxLoc(share)
            if best < MIN_VOTES:
                break
            centre = (np.array(place) * 2 + 1.0) * CELL_MM + corner_mm
            out.append((best, np.array([*centre, radius, height_mm])))
            cv2.circle(share, place, 4, 0.0, -1)
    return out


def _most_in_blocks(rows: NDArray[np.int64], columns: NDArray[np.int64], side: int) -> int:
    """The most votes in four neighbouring blocks of 4 x 4 cells: no 3 x 3 cells have more. side: of the grid, cells."""
    blocks = side // 4 + 2
    counts = np.bincount((rows >> 2) * blocks + (columns >> 2), minlength=blocks * blocks)
    counts = counts.reshape(blocks, blocks)
    pairs = counts[1:] + counts[:-1]
    return int((pairs[:, 1:] + pairs[:, :-1]).max())


def _shared_edges(
    above: list[Float32Array], is_seen: MaskArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], Float64Array]:
    """Rows, columns and (n, 2) unit gradients where both views from above have a like edge, thinned to its crest."""
    x, y = (
        [cv2.Sobel(image, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for image in above]
        for order in ((1, 0), (0, 1))
    )
    size = [cv2.magnitude(*each) for each in zip(x, y, strict=True)]
    rows, columns = np.nonzero((np.minimum(*size) > LEAST_STEP / 2) & is_seen)
    (x0, x1), (y0, y1), (size0, size1) = (
        [each[rows, columns] for each in pair] for pair in (x, y, size)
    )
    is_like = x0 * x1 + y0 * y1 > SAME_DIRECTION * size0 * size1
    rows, columns = rows[is_like], columns[is_like]
    agreed = np.zeros(is_seen.shape, np.float32)
    agreed[rows, columns] = np.minimum(size0, size1)[is_like]
    crest = cv2.dilate(agreed, np.ones((3, 3), np.uint8))
    both = np.column_stack([x0 + x1, y0 + y1])[is_like].astype(np.float64)
    is_thin = agreed[rows, columns] >= 0.9 * crest[rows, columns]
    towards = both[is_thin] / np.linalg.norm(both[is_thin], axis=1)[:, None]
    return rows[is_thin], columns[is_thin], towards


def circle_points(unknowns: Float64Array, samples: int = SAMPLES) -> Float64Array:
    """(..., samples, 3) mm on circles (..., 4): x, y, radius, height."""
    angle = np.arange(samples) * (2 * np.pi / samples)
    x, y, radius, height = (unknowns[..., axis, None] for axis in range(4))
    return np.stack(
        [x + radius * np.cos(angle), y + radius * np.sin(angle), height + 0.0 * angle], axis=-1
    )


def refine_circles(
    sight: Sight, grey: list[Float32Array], starts: Float64Array
) -> list[Circle | None]:
    """Gauss-Newton of centre, radius and height, (n, 4), on the edges beside the projected circles in both views."""
    unknowns = starts.astype(np.float64).copy()
    places = np.arange(len(starts))  # of those that are still circles that are sought
    for turn in range(ROUNDS):
        design, rest, seen = [], [], []
        for view in (0, 1):
            jacobian, offset, step, _ = across(
                sight, grey[view], unknowns[places], view, SEARCH_PX if turn < 3 else 3
            )
            weight = np.sqrt(
                ((step > LEAST_STEP) & np.isfinite(offset)) / (1.0 + np.nan_to_num(offset) ** 2)
            )
            seen.append((weight > 0).mean(axis=1))
            design.append(jacobian * weight[..., None])
            rest.append(np.nan_to_num(offset) * weight)
        rows, rests = np.concatenate(design, axis=1), np.concatenate(rest, axis=1)
        normal = rows.mT @ rows + np.diag([1e-4] * 4)
        unknowns[places] += np.clip(
            np.linalg.solve(normal, rows.mT @ rests[..., None])[..., 0], -6.0, 6.0
        )
        _, _, radius, height = unknowns[places].T
        is_sought = (
            (np.minimum(*seen) > LEAST_SEEN)
            & (0.8 * RADII_MM[0] < radius)
            & (radius < 1.1 * RADII_MM[1])
            & (height > 8.0)
            & (height < 200.0)
        )
        places = places[is_sought]
        if not len(places):
            break
    circles: list[Circle | None] = [None] * len(starts)
    for place, cover in zip(
        places.tolist(), _cover(sight, grey, unknowns[places]).tolist(), strict=True
    ):
        if cover >= MIN_COVER:
            x, y, radius, height = unknowns[place].tolist()
            circles[place] = Circle(np.array([x, y]), radius, height, cover)
    return circles


def _cover(sight: Sight, grey: list[Float32Array], circles: Float64Array) -> Float64Array:
    """(n,) share of the directions of circles, (n, 4), with an edge on them, in the view that shows less."""
    if not len(circles):
        return np.empty(0)
    shares = []
    for view in (0, 1):
        _, offset, step, _ = across(sight, grey[view], circles, view, 3)
        shares.append(((step > LEAST_STEP) & (np.abs(offset) < ON_EDGE_PX)).mean(axis=1))
    return np.asarray(np.minimum(*shares), np.float64)


def across(
    sight: Sight, grey: Float32Array, unknowns: Float64Array, view: int, reach_px: int
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Return what lies across the projections of circles, (..., 4), for n directions of each.

    (..., n, 4) derivative of the offset by the unknowns, px/mm; (..., n) offset of the strongest edge along the outward
    normal, px, NaN without one; (..., n) its step over two pixels, grey levels; (..., n) its sign, positive if it is
    brighter outside.
    """
    shape = (*unknowns.shape[:-1], SAMPLES)
    points = circle_points(unknowns).reshape(-1, 3)
    pixels = sight.in_view(*sight.project(points), view)
    gradient = sight.pixel_gradient(points, view)
    angle = np.arange(SAMPLES) * (2 * np.pi / SAMPLES)
    cos, sin = (
        np.broadcast_to(each, shape).reshape(-1, 1) for each in (np.cos(angle), np.sin(angle))
    )
    by_x, by_y, by_height = (gradient[..., axis] for axis in range(3))
    outward, along = by_x * cos + by_y * sin, by_y * cos - by_x * sin
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal *= np.where((normal * outward).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    normal /= np.hypot(normal[:, 0], normal[:, 1])[:, None]
    jacobian = np.column_stack(
        [(normal * each).sum(axis=1) for each in (by_x, by_y, outward, by_height)]
    )
    shifts = np.arange(-reach_px - 1, reach_px + 2)
    where = pixels[:, None] + shifts[None, :, None] * normal[:, None]
    profile = sampled(grey, where, beyond=np.nan)
    steps = profile[:, 2:] - profile[:, :-2]
    size = np.nan_to_num(np.abs(steps))
    # Nearer edges win against somewhat stronger ones farther off.
    nearness = (1.0 / (1.0 + 0.15 * np.abs(shifts[1:-1]))).astype(np.float32)
    best = np.argmax(size * nearness, axis=1)
    index = np.arange(len(points))
    middle = np.clip(best, 1, size.shape[1] - 2)
    low, peak, high = size[index, middle - 1], size[index, middle], size[index, middle + 1]
    bend = low - 2 * peak + high
    shift = np.where(bend < -1e-6, 0.5 * (low - high) / np.minimum(bend, -1e-6), 0.0)
    is_peak = (best == middle) & (np.abs(shift) <= 1.0)
    offset = np.where(is_peak, shifts[1:-1][middle] + np.clip(shift, -1, 1), np.nan)
    step, sign = size[index, best], np.sign(steps[index, best])
    return (
        jacobian.reshape(*shape, 4),
        offset.reshape(shape),
        step.reshape(shape),
        sign.reshape(shape),
    )
