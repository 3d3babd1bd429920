"""The dishes under the food, found from above: plates, bowls and boards, whose rims stand out from the table.

Top view -> each dish's outline, the height of its rim, and, where the outline is a circle, its centre and radius.
Nothing is assumed of its size or profile: a rim is a closed line of one height that is higher than what lies outside
it and no lower than most of what lies just inside.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry.masks import components, inward_px, opened
from app.vision.geometry.pictures import sampled
from app.vision.geometry.topview import TopView
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.scene.scene import commonest
from app.vision.scene.sectors import sector_of
from app.vision.tuning import FLOOR_TUNING

RADII_MM = (50.0, 260.0)  # of a round dish: a dessert bowl to a serving platter
RIM_RANGE_MM = (4.0, 90.0)  # over the table
RIM_NOISE = 2.5  # standard deviations of a cell of table, which a rim must exceed
SAME_HEIGHT_MM = 4.0  # of the rim's plane
MAX_SLOPE = 0.05  # of the rim's plane: what small errors of the poses may make of a level rim
MAX_STEP_MM = 12.0  # between three places of one rim
ON_RIM_MM = 5.0
EDGE_MM = 12.0  # within which a rim's outer edge falls, widened by a window
EDGE_FALL = 0.5  # of its height
# beyond the rim, where the table should be seen and not another, higher rim
OUTSIDE_MM = (8.0, 28.0)
INSIDE_MM = 12.0  # within the rim
RISE_MM = 3.0
HIGHER_MM = 2 * RISE_MM  # over a level: no part of it
SECTORS = 48
MIN_COVER = 0.55  # of the sectors in which the rim is seen
MIN_WALL_CELLS = 4  # of some 30 that a sector has outside: fewer are noise
MIN_EDGE_COVER = 0.4  # of the sectors in which it is seen and nothing as high lies outside
MAX_CLIMBING = 0.45  # of the sectors in which the rim is seen: where the surface climbs on just within, it is a flank
LEVEL_SHARE = 0.5  # of what is measured within the circle and as high as its edge: a flat top
SLOPE_WEIGHT = 10.0
REFINEMENTS = 3
TRIALS = 2000
LEVELS = 8  # parts of the cells by their height: three of one rim come from two neighbouring ones at most
MAX_CELLS = 700
MAX_CANDIDATES, MAX_TRIED = 12, 20
SAME_RADIUS_MM, SAME_PLACE_MM = 6.0, 8.0  # within which two circles are one
MIN_DETERMINANT_MM2 = 800.0
MIN_DENSITY = 0.15  # of the points that a cell facing the camera would show
MIN_SLAB_MM2 = 15000.0  # larger than a slice of bread or a steak
BEYOND_CIRCLE = 1.15  # times a circle's area: a slab so much larger is not that circle
MIN_STANDING = 0.02  # of a board: what stands on it
MAX_SEARCHES = 8  # for dishes of one table
MAX_SHARED = 0.25  # of the smaller of two dishes, which may lie within the other's outline
APART_MM = 4.0  # beyond a dish's outline, up to which what stands out is still its rim
DEEP_SHARE = 0.3  # of the radius: a dish whose rim is higher over the table is a bowl


@dataclass(frozen=True, slots=True)
class Dish:
    """A plate, bowl or board.

    inward_mm: (rows, columns) of the top view, distance inward from the outline, negative outside
    rim_mm: the rim's height over the table
    floor_mm: a board's top, which is as high as its rim; 0 for other dishes, whose floor is seldom measured
    floor_sd_mm: standard deviation of a board's top
    centre_mm: (2,) of a round dish, else None
    radius_mm: of a round dish, else None
    """

    inward_mm: Float32Array
    rim_mm: float
    floor_mm: float = 0.0
    floor_sd_mm: float = FLOOR_TUNING.board_over_rim_mm[1]  # as a rim tells it
    centre_mm: Float64Array | None = None
    radius_mm: float | None = None

    @property
    def is_deep(self) -> bool:
        """A bowl rather than a plate or board."""
        return self.radius_mm is not None and self.rim_mm > DEEP_SHARE * self.radius_mm

    def inward_at(self, view: TopView, xy_mm: Float64Array | Float32Array) -> Float32Array:
        """(H, W) distance inward at (H, W, 2) mm; far outside: -100; NaN positions give -100."""
        cells = view.cells_px(xy_mm)
        cv2.patchNaNs(cells, -1e4)
        return sampled(self.inward_mm, cells, beyond=-100.0)


@dataclass(frozen=True, slots=True)
class _Ring:
    x_mm: float
    y_mm: float
    radius_mm: float
    height_mm: float
    slope: tuple[float, float]
    cover: float
    edge_cover: float

    @property
    def circle(self) -> tuple[float, float, float]:
        return self.x_mm, self.y_mm, self.radius_mm

    def near(self, cells: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(m, 3) those of the cells (n, 3) that lie on the ring or within it, and (4, m) where, see _apart."""
        reach_mm = self.radius_mm + ON_RIM_MM
        is_near = np.abs(cells[:, 0] - self.x_mm) < reach_mm
        is_near &= np.abs(cells[:, 1] - self.y_mm) < reach_mm
        plane = np.array([self.height_mm, *self.slope])
        return cells[is_near], _apart(cells[is_near], self.x_mm, self.y_mm, plane)

    def holds(self, other: "_Ring") -> bool:
        """Whether the other lies within this one, and lower: as what fills a bowl lies within its rim."""
        apart = float(np.hypot(self.x_mm - other.x_mm, self.y_mm - other.y_mm))
        is_within = apart + other.radius_mm < self.radius_mm + SAME_RADIUS_MM
        return (
            is_within
            and self.radius_mm > other.radius_mm
            and self.height_mm > other.height_mm + RISE_MM
        )


def solid_cells(view: TopView, points_per_mm2: float) -> MaskArray:
    """(rows, columns) cells with enough points to be a surface. points_per_mm2: of one that faces the camera."""
    least = max(1.0, MIN_DENSITY * points_per_mm2 * view.cell_mm**2)
    return np.isfinite(view.height_mm) & (view.count >= least)


def find_dishes(
    view: TopView,
    is_solid: MaskArray,
    noise_mm: float,
    rng: np.random.Generator,
    with_floor: Callable[[Dish], Dish],
) -> list[Dish]:
    """Return the dishes with closed rims, the best first; heights of the view are over the table.

    What belongs to one dish has no part in the next one: a rim beside it counts as table there.

    with_floor: tells a board from a plate
    """
    dishes: list[Dish] = []
    remaining = is_solid
    for _ in range(MAX_SEARCHES):
        dish = _best_dish(view, remaining, noise_mm, rng, with_floor)
        if dish is None:
            break
        if not any(_overlap(dish, other) for other in dishes):
            dishes.append(dish)
        remaining = remaining & (dish.inward_mm < -APART_MM)
    return dishes


def _overlap(dish: Dish, other: Dish) -> bool:
    """Whether two outlines cover so much of each other that they belong to one dish: its rim and a fringe of it."""
    areas = [np.count_nonzero(each.inward_mm > 0) for each in (dish, other)]
    shared = np.count_nonzero((dish.inward_mm > 0) & (other.inward_mm > 0))
    return bool(shared > MAX_SHARED * min(areas))


def _best_dish(
    view: TopView,
    is_solid: MaskArray,
    noise_mm: float,
    rng: np.random.Generator,
    with_floor: Callable[[Dish], Dish],
) -> Dish | None:
    round_dish = _find_round(view, is_solid, noise_mm, rng)
    slab = _find_slab(view, is_solid, noise_mm)
    if round_dish is None or slab is None:
        only = round_dish or slab
        return None if only is None else with_floor(only)
    # A circle fits into any board: it is one only if nothing much of the board lies outside. A round rim is not flat.
    areas = [np.count_nonzero(dish.inward_mm > 0) for dish in (slab, round_dish)]
    if areas[0] > BEYOND_CIRCLE * areas[1]:
        slab = with_floor(slab)
        if slab.floor_mm > 0:
            return slab
    return with_floor(round_dish)


def _find_round(
    view: TopView, is_solid: MaskArray, noise_mm: float, rng: np.random.Generator
) -> Dish | None:
    raised = _raised(view, is_solid, noise_mm)
    edge = raised & _is_edge(view, raised)
    places = view.centres_mm()
    cells, at_edge, solid = (
        np.asfortranarray(np.column_stack([places[chosen], view.height_mm[chosen]]))
        for chosen in (raised, edge, is_solid)
    )
    if len(cells) < SECTORS // 2:
        return None
    rims: list[tuple[float, _Ring]] = []
    for ring in _candidates(cells, cells, rng) + _candidates(at_edge, cells, rng):
        if ring.cover < MIN_COVER or ring.edge_cover < MIN_EDGE_COVER:
            continue
        is_flank = _climbing_share(solid, ring) > MAX_CLIMBING
        if not is_flank and not _is_flat_top(solid, view.cell_mm, ring):
            merit = ring.cover + ring.edge_cover + ring.radius_mm / (2 * RADII_MM[1])
            rims.append((merit - SLOPE_WEIGHT * float(np.hypot(*ring.slope)), ring))
    if not rims:
        return None
    ring = max(rims, key=lambda rim: rim[0])[1]
    # What fills a bowl may show a whole edge, where the rim around it shows only parts.
    ring = max(
        (rim for rim in rims if rim[1].holds(ring)), default=(0.0, ring), key=lambda rim: rim[0]
    )[1]
    centre = np.array([ring.x_mm, ring.y_mm])
    inward = ring.radius_mm - np.linalg.norm(places - centre, axis=-1)
    return Dish(
        inward.astype(np.float32), ring.height_mm, centre_mm=centre, radius_mm=ring.radius_mm
    )


def _raised(view: TopView, is_solid: MaskArray, noise_mm: float) -> MaskArray:
    """(rows, columns) cells as high as a rim may be."""
    low = max(RIM_RANGE_MM[0], RIM_NOISE * noise_mm)
    return opened(is_solid & (view.height_mm > low) & (view.height_mm < RIM_RANGE_MM[1]), 2)


def _is_edge(view: TopView, raised: MaskArray) -> MaskArray:
    """(rows, columns) where the surface falls to less than half near by, and which nothing near by overtops.

    A full board has as many circles in its top as a rim has at its edge; only those at the edge bound it.
    """
    height = np.where(raised, view.height_mm, np.float32(0.0)).astype(np.float32)
    side = 2 * round(EDGE_MM / view.cell_mm) + 1
    near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    falls = cv2.erode(height, near) < EDGE_FALL * height
    return falls & (cv2.dilate(height, near) < height + SAME_HEIGHT_MM)


def _candidates(cells: Float64Array, every: Float64Array, rng: np.random.Generator) -> list[_Ring]:
    """Circles through three cells of one height, those that most sectors support, each fitted to its cells.

    cells: (n, 3) through which circles are drawn. every: (m, 3) all that is raised, which says what lies outside.
    """
    if len(cells) < SECTORS // 2:
        return []
    few = (
        cells
        if len(cells) <= MAX_CELLS
        else cells[rng.choice(len(cells), MAX_CELLS, replace=False)]
    )
    by_height = cells[np.argsort(cells[:, 2])]
    first = rng.integers(len(cells), size=(TRIALS, 1))
    others = first + rng.integers(-len(cells) // LEVELS, len(cells) // LEVELS + 1, size=(TRIALS, 2))
    picks = by_height[np.clip(np.hstack([first, others]), 0, len(cells) - 1)]
    picks = picks[np.ptp(picks[..., 2], axis=1) < MAX_STEP_MM]
    to_second, to_third = picks[:, 1, :2] - picks[:, 0, :2], picks[:, 2, :2] - picks[:, 0, :2]
    determinant = to_second[:, 0] * to_third[:, 1] - to_second[:, 1] * to_third[:, 0]
    kept = np.abs(determinant) > MIN_DETERMINANT_MM2
    picks, to_second, to_third, determinant = (
        picks[kept],
        to_second[kept],
        to_third[kept],
        determinant[kept],
    )
    squares_one, squares_two = 0.5 * (to_second**2).sum(1), 0.5 * (to_third**2).sum(1)
    centre_x = (squares_one * to_third[:, 1] - squares_two * to_second[:, 1]) / determinant
    centre_y = (squares_two * to_second[:, 0] - squares_one * to_third[:, 0]) / determinant
    radius = np.hypot(centre_x, centre_y)
    rise_one, rise_two = picks[:, 1, 2] - picks[:, 0, 2], picks[:, 2, 2] - picks[:, 0, 2]
    slope_x = (rise_one * to_third[:, 1] - rise_two * to_second[:, 1]) / determinant
    slope_y = (rise_two * to_second[:, 0] - rise_one * to_third[:, 0]) / determinant
    kept = (
        (radius > RADII_MM[0]) & (radius < RADII_MM[1]) & (np.hypot(slope_x, slope_y) < MAX_SLOPE)
    )
    if not kept.any():
        return []
    rings = np.column_stack([picks[:, 0, :2] + np.column_stack([centre_x, centre_y]), radius])[kept]
    slopes = np.column_stack([slope_x, slope_y])[kept]
    heights = picks[kept, 0, 2] + (slopes * np.column_stack([centre_x, centre_y])[kept]).sum(axis=1)
    near, circles, tilts = (np.asarray(each, np.float32) for each in (few, rings, slopes))
    levels = heights.astype(np.float32)[:, None]
    dx = near[None, :, 0] - circles[:, :1]
    dy = near[None, :, 1] - circles[:, 1:2]
    beyond = np.sqrt(dx * dx + dy * dy) - circles[:, 2:]
    over = near[None, :, 2] - levels - tilts[:, :1] * dx - tilts[:, 1:] * dy
    on_rim = (np.abs(beyond) < ON_RIM_MM) & (np.abs(over) < SAME_HEIGHT_MM)
    hits = _sectors_of(on_rim, dx, dy)
    outside = (
        (beyond > OUTSIDE_MM[0])
        & (beyond < OUTSIDE_MM[1])
        & (near[None, :, 2] > levels - SAME_HEIGHT_MM)
    )
    walled = _sectors_of(outside, dx, dy)
    score = hits.sum(axis=1) + (hits & ~walled).sum(axis=1)
    kept_rings: list[_Ring] = []
    tried: list[tuple[float, float, float]] = []
    for place in np.argsort(-score):
        x, y, r = (float(value) for value in rings[place])
        if _is_among((x, y, r), tried):
            continue
        tried.append((x, y, r))
        ring = _refined(cells, every, (x, y, r), np.array([heights[place], *slopes[place]]))
        if ring is not None and not _is_among(ring.circle, [other.circle for other in kept_rings]):
            kept_rings.append(ring)
        if len(kept_rings) >= MAX_CANDIDATES or len(tried) >= MAX_TRIED:
            break
    return kept_rings


def _sectors_of(chosen: MaskArray, dx_mm: Float32Array, dy_mm: Float32Array) -> MaskArray:
    """(n, SECTORS) directions in which a ring has a chosen cell, (n, m), each so far from the ring's centre."""
    index = np.flatnonzero(chosen)
    has_cell = np.zeros((len(chosen), SECTORS), np.bool_)
    sector = sector_of(dx_mm.ravel()[index], dy_mm.ravel()[index], SECTORS)
    has_cell[index // chosen.shape[1], sector] = True
    return has_cell


def _is_among(circle: tuple[float, float, float], others: list[tuple[float, float, float]]) -> bool:
    """Whether a circle (x, y, radius, mm) is nearly one of the others."""
    return any(
        abs(circle[2] - other[2]) < SAME_RADIUS_MM
        and np.hypot(circle[0] - other[0], circle[1] - other[1]) < SAME_PLACE_MM
        for other in others
    )


def _refined(
    cells: Float64Array,
    every: Float64Array,
    circle: tuple[float, float, float],
    plane: Float64Array,
) -> _Ring | None:
    """Least squares circle through the cells on the rim, and how much of it every cell shows; None if it runs away.

    circle: x, y, radius, mm. plane: (3,) height at its centre, mm, and slopes.
    """
    x, y, radius = circle
    for _ in range(REFINEMENTS):
        _, _, distance, over = _apart(cells, x, y, plane)
        near = (np.abs(distance - radius) < 1.2 * ON_RIM_MM) & (np.abs(over) < SAME_HEIGHT_MM)
        if np.count_nonzero(near) < SECTORS // 4:
            return None
        on_rim = cells[near]
        design = np.column_stack([2 * on_rim[:, :2], np.ones(len(on_rim))])
        (x, y, rest), *_ = np.linalg.lstsq(design, (on_rim[:, :2] ** 2).sum(axis=1), rcond=None)
        radius = float(np.sqrt(max(rest + x * x + y * y, 0.0)))
        levels = np.column_stack([np.ones(len(on_rim)), on_rim[:, :2] - [x, y]])
        plane = np.linalg.lstsq(levels, on_rim[:, 2], rcond=None)[0]
    if not RADII_MM[0] < radius < RADII_MM[1] or np.hypot(plane[1], plane[2]) > MAX_SLOPE:
        return None
    dx, dy, distance, over = _apart(every, x, y, plane)
    is_rim = (np.abs(distance - radius) < ON_RIM_MM) & (np.abs(over) < SAME_HEIGHT_MM)
    is_outside = (distance > radius + OUTSIDE_MM[0]) & (distance < radius + OUTSIDE_MM[1])
    is_wall = is_outside & (over > -SAME_HEIGHT_MM)
    rims, walls = (
        np.bincount(sector_of(dx[chosen], dy[chosen], SECTORS), minlength=SECTORS)
        for chosen in (is_rim, is_wall)
    )
    seen, walled = rims > 0, walls >= MIN_WALL_CELLS
    return _Ring(
        float(x),
        float(y),
        radius,
        float(plane[0]),
        (float(plane[1]), float(plane[2])),
        float(seen.mean()),
        float((seen & ~walled).mean()),
    )


def _apart(cells: Float64Array, x_mm: float, y_mm: float, plane: Float64Array) -> Float64Array:
    """(4, n) mm along x and y, straight, and up of cells (n, 3) from a place on a plane, see _refined."""
    x, y, height = cells.T
    dx, dy = x - x_mm, y - y_mm
    over = height - plane[0] - plane[1] * dx - plane[2] * dy
    return np.stack([dx, dy, np.sqrt(dx * dx + dy * dy), over])


def _climbing_share(solid: Float64Array, ring: _Ring) -> float:
    """Share of the sectors in which the rim is seen where the surface climbs on within: a circle around three foods."""
    _, (x, y, distance, over) = ring.near(solid)
    sector, inward = sector_of(x, y, SECTORS), ring.radius_mm - distance
    within = (inward > ON_RIM_MM) & (inward < INSIDE_MM)
    on_rim = (np.abs(inward) < ON_RIM_MM) & (np.abs(over) < SAME_HEIGHT_MM)
    is_higher = within & (over > RISE_MM)
    seen, measured, higher = (
        np.bincount(sector[chosen], minlength=SECTORS) for chosen in (on_rim, within, is_higher)
    )
    climbs = (higher > 0.5 * measured)[seen > 0]
    return float(climbs.mean()) if climbs.size else 0.0


def _is_flat_top(solid: Float64Array, cell_mm: float, ring: _Ring) -> bool:
    """Return whether a circle lies in the flat top of a block; food stands on a board's top."""
    cells, (_, _, distance, over) = ring.near(solid)
    inward = ring.radius_mm - distance
    area_mm2 = np.pi * ring.radius_mm**2
    is_large = area_mm2 >= MIN_SLAB_MM2
    standing = (cells[:, 2] > ring.height_mm + HIGHER_MM) & (inward > 0)
    is_board = is_large and np.count_nonzero(standing) * cell_mm**2 >= MIN_STANDING * area_mm2
    over_rim = over[inward > OUTSIDE_MM[0]]
    if is_board or not len(over_rim):
        return False
    # A slice of bread has no level top; a saucer's inside lies lower than the rim.
    is_top = np.abs(over_rim) < RISE_MM if is_large else over_rim > -RISE_MM
    return float(np.mean(is_top)) > LEVEL_SHARE


def _find_slab(view: TopView, is_solid: MaskArray, noise_mm: float) -> Dish | None:
    """A dish that is not round: the hull of a large cluster at one height, which its border holds all round."""
    raised = _raised(view, is_solid, noise_mm)
    link = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
    best: tuple[float, Dish] | None = None
    for part in components(cv2.dilate(raised.astype(np.uint8), link) > 0):
        cluster = raised & part
        if np.count_nonzero(cluster) < SECTORS:
            continue
        level = commonest(view.height_mm[cluster], SAME_HEIGHT_MM)
        at_level = cluster & (np.abs(view.height_mm - level) < SAME_HEIGHT_MM)
        higher = is_solid & (view.height_mm > level + HIGHER_MM)
        # without flanks of what stands on it, or beside it
        at_level &= cv2.dilate(higher.astype(np.uint8), link) == 0
        rows, columns = np.nonzero(at_level)
        if len(rows) < SECTORS:
            continue
        hull = np.asarray(
            cv2.convexHull(np.column_stack([columns, rows]).astype(np.int32)), np.int32
        )
        area = float(cv2.contourArea(hull)) * view.cell_mm**2
        if area < MIN_SLAB_MM2 or (best is not None and area < best[0]):
            continue
        inward = inward_of(hull, view)
        border = (inward > 0) & (inward < INSIDE_MM)
        if _sector_share(at_level, border) < MIN_COVER + 0.1:
            continue
        standing = higher & (inward > 0)
        if np.count_nonzero(standing) * view.cell_mm**2 < MIN_STANDING * area:
            continue
        best = area, Dish(inward, level)
    return best[1] if best else None


def inward_of(polygon: NDArray[np.int32], view: TopView) -> Float32Array:
    """Return (rows, columns) the distance inward from a convex polygon, mm, negative outside.

    polygon: (n, 2) cells
    """
    picture = np.zeros(view.height_mm.shape, np.uint8)
    cv2.fillConvexPoly(picture, polygon, 1)
    return (inward_px(picture > 0) - inward_px(picture == 0)) * view.cell_mm


def _sector_share(at_level: MaskArray, border: MaskArray) -> float:
    """Share of the border's sectors, seen from its middle, in which a quarter of the cells are at the level."""
    rows, columns = np.nonzero(border)
    sector = sector_of(columns - columns.mean(), rows - rows.mean(), SECTORS)
    total = np.bincount(sector, minlength=SECTORS)
    held = np.bincount(sector[at_level[border]], minlength=SECTORS)
    return float((held >= 0.25 * total)[total > 0].mean())
