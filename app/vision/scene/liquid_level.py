"""Where a liquid's surface meets the inside of a vessel: the best circle about the rim's axis, below it, by colour.

The rim and both views -> the surface's radius and height. A liquid mirrors and has no parallax of its own; its edge on
the inner wall has. Only what the rim leaves in view counts, of that mostly the far side.
"""

from dataclasses import dataclass

import numpy as np

from app.vision.geometry.pictures import sampled
from app.vision.model import Float32Array, Float64Array, MaskArray
from app.vision.scene.rims import SAMPLES, Circle, across, circle_points
from app.vision.views.sight import Sight

# the rim: a surface nearer to the brim is that of something solid, or the rim itself
LEAST_BELOW_MM = 3.0
LOWEST_SHARE = 0.2  # of the rim's height: lower circles are where a floor begins
RADIUS_SHARES = (0.4, 1.0)  # of the rim's
LEVEL_STEP_MM, RADIUS_STEP_MM = 2.0, 1.5
BESIDE_MM = 1.5  # across the edge, where its colours are taken
CLEAR_MM = 2.5  # inside the rim's circle, to be seen past it
MIN_VISIBLE = 0.2  # of the circle, in each view
MIN_CONTRAST = 8.0  # CIELAB, across the surface's edge
MIN_AGREED = 0.6  # of the visible edge, with a like step of colour
ROUNDS = 6
CENTRE_SD_MM = 0.5  # of the surface's axis about the rim's
LEAST_SD_MM = 0.4
PIXEL_SD = 0.5  # of an edge's place, px; neighbouring directions err alike
DIRECTIONS_PER_FACT = 6.0
# of parallax, by poses and by edges that are not quite the same line in both views
SHARED_SD_PX = 0.4


@dataclass(frozen=True, slots=True)
class Level:
    """height_mm over the marker's plane and radius_mm of the surface. sd_mm: of both, by the fit (height, radius).

    lift_sd_mm: of the height, by what errs alike for rim and surface.
    is_in_glass: whether it is seen through the wall.
    """

    height_mm: float
    radius_mm: float
    sd_mm: tuple[float, float]
    lift_sd_mm: float = 0.0
    is_in_glass: bool = False


def find_level(
    sight: Sight,
    lab: tuple[Float32Array, Float32Array],
    grey: list[Float32Array],
    rim: Circle,
    table_mm: float,
) -> Level | None:
    """The surface with the greatest contrast to the wall; None where no circle below the rim stands out."""
    lowest = table_mm + LOWEST_SHARE * (rim.height_mm - table_mm)
    best, start = 0.0, None
    for height in np.arange(rim.height_mm - LEAST_BELOW_MM, lowest, -LEVEL_STEP_MM):
        for radius in (
            np.arange(RADIUS_SHARES[1], RADIUS_SHARES[0], -RADIUS_STEP_MM / rim.radius_mm)
            * rim.radius_mm
        ):
            score = _contrast(sight, lab, rim, float(height), float(radius))
            if score > best:
                best, start = score, np.array([*rim.centre_mm, radius, height])
    if start is None or best < MIN_CONTRAST:
        return None
    return _refined(sight, grey, rim, start)


def visible(sight: Sight, rim: Circle, points: Float64Array, view: int) -> MaskArray:
    """(n,) whether points inside the vessel are seen past its rim."""
    return rim_crossing_mm(sight, rim, points, view) < rim.radius_mm - CLEAR_MM


def rim_crossing_mm(sight: Sight, rim: Circle, points: Float64Array, view: int) -> Float64Array:
    """(n,) distance from the rim's axis at which the lines of sight to (n, 3) points cross the rim's height, mm."""
    camera = sight.cameras_mm[view]
    share = (camera[2] - rim.height_mm) / (camera[2] - points[:, 2])
    crossing = camera[:2] + share[:, None] * (points[:, :2] - camera[:2])
    return np.asarray(np.linalg.norm(crossing - rim.centre_mm, axis=1), np.float64)


def _contrast(
    sight: Sight,
    lab: tuple[Float32Array, Float32Array],
    rim: Circle,
    height_mm: float,
    radius_mm: float,
) -> float:
    """CIELAB step across the circle in the view that shows less of one, 0 where too little agrees."""
    scores = []
    for view in (0, 1):
        sides = []
        is_seen = np.ones(SAMPLES, np.bool_)
        for radius in (radius_mm - BESIDE_MM, radius_mm + BESIDE_MM):
            points = rim.ring(radius, height_mm)
            is_seen &= visible(sight, rim, points, view)
            sides.append(colours_at(lab[view], sight.in_view(*sight.project(points), view)))
        if is_seen.mean() < MIN_VISIBLE:
            return 0.0
        step = (sides[1] - sides[0])[is_seen]
        mean = np.median(step, axis=0)
        size = float(np.linalg.norm(mean))
        agreed = float((step @ mean > 0.5 * size**2).mean())
        scores.append(size * agreed if agreed > MIN_AGREED else 0.0)
    return min(scores)


def _refined(
    sight: Sight, grey: list[Float32Array], rim: Circle, start: Float64Array
) -> Level | None:
    """Height, radius and, a little, the axis by Gauss-Newton on the edges in both views."""
    unknowns = start.copy()
    prior = np.diag([1 / CENTRE_SD_MM**2, 1 / CENTRE_SD_MM**2, 1e-4, 1e-4])
    normal = prior
    for turn in range(ROUNDS):
        normal = prior.copy()
        rest = prior @ (start - unknowns)
        for view in (0, 1):
            jacobian, offset, step, sign = across(
                sight, grey[view], unknowns, view, 4 if turn < 2 else 2
            )
            is_seen = (
                visible(sight, rim, circle_points(unknowns), view)
                & np.isfinite(offset)
                & (step > 0)
            )
            if not is_seen.any():
                return None
            usual = np.sign(np.sum(sign[is_seen] * step[is_seen]))
            weight = (is_seen & (sign == usual)) / (1.0 + np.nan_to_num(offset) ** 2)
            weight /= PIXEL_SD**2 * DIRECTIONS_PER_FACT
            normal += jacobian.T @ (jacobian * weight[:, None])
            rest += jacobian.T @ (np.nan_to_num(offset) * weight)
        unknowns = unknowns + np.clip(np.linalg.solve(normal, rest), -3.0, 3.0)
    radius, height = float(unknowns[2]), float(unknowns[3])
    if (
        height > rim.height_mm - LEAST_BELOW_MM / 2
        or not 0.3 * rim.radius_mm < radius < 1.03 * rim.radius_mm
    ):
        return None
    sd = np.sqrt(np.diag(np.linalg.inv(normal)))
    return Level(
        height,
        radius,
        (float(np.hypot(sd[3], LEAST_SD_MM)), float(np.hypot(sd[2], LEAST_SD_MM))),
        lift_sd_mm(sight, unknowns),
    )


def lift_sd_mm(sight: Sight, unknowns: Float64Array) -> float:
    """Sd of the height that an error of parallax common to the whole circle makes, mm."""
    middle = np.array([[unknowns[0], unknowns[1], unknowns[3] + lift] for lift in (-1.0, 1.0)])
    _, parallax = sight.project(middle)
    return float(SHARED_SD_PX * 2.0 / max(abs(parallax[1] - parallax[0]), 1e-6))


def colours_at(lab: Float32Array, pixels: Float64Array) -> Float64Array:
    """(n, 3) CIELAB at (n, 2) px."""
    return np.asarray(sampled(lab, pixels), np.float64).reshape(-1, 3)
