"""What fills a bowl: its top as measured, its unseen inside as the outer wall moved inwards by the wall's thickness.

Points of the content, the bowl (vessel.py) and its floor -> volume and its spread, which grows with what is not seen.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from app.core.units import ml_from_mm3
from app.vision.geometry.mesh import ClosedShape
from app.vision.geometry.slices import Slice, disc, turned
from app.vision.model import Float64Array
from app.vision.scene.vessel import Vessel

THICKNESS_MM = (2.0, 8.0)  # of a wall: thin china to thick stoneware
THICKNESS_SD_MM = 1.5  # with the outer radius's
LEVEL_SD_MM = 1.0  # of where the content meets the wall
STEP_MM = 1.0
SLICE_MM = 4.0
CELL_MM = 4.0  # of the top, seen from above: each counts once, however many points show it
RIM_QUANTILE = 0.97  # of the content's distances from the middle: its far edge lies on the wall
EDGE_SHARE = 0.85  # of that radius, from which on the content's height is its level at the wall
MIN_EDGE_POINTS = 30
WALL_SD_MM = 2.0  # of one step of the seen wall
FOOT_SHARE = (0.5, 0.15)  # of a bowl's foot in its rim's radius: mean and spread
POWER = (0.5, 0.2)  # of the wall's curve: a cone has 1, a cylinder 0


@dataclass(frozen=True, slots=True)
class BowlContent:
    """volume_ml, sd_ml: of the content. slices: of what lies below its level at the wall.

    shape: of all of it, z from the bowl's inside floor; its top is a vault of the heap's mean height, for whose true
    form a mean says nothing.
    """

    volume_ml: float
    sd_ml: float
    slices: tuple[Slice, ...]
    shape: ClosedShape


def measure_content(
    points_table: Float64Array, vessel: Vessel, table_mm: float, floor_mm: float, floor_sd_mm: float
) -> BowlContent | None:
    """None where too little of the content is measured. How little of the wall is seen shows in sd_ml.

    points_table: (n, 3) of the content, heights over the table. table_mm: height of the table over the marker's plane,
    from which the vessel's heights count. floor_mm, floor_sd_mm: of the bowl's inside, over the table.
    """
    wall = _fit_wall(vessel, table_mm)
    distance = np.linalg.norm(points_table[:, :2] - vessel.centre_mm, axis=1)
    content = points_table[distance < vessel.radius_mm]
    distance = distance[distance < vessel.radius_mm]
    if len(content) < MIN_EDGE_POINTS:
        return None
    edge_mm = float(np.quantile(distance, RIM_QUANTILE))
    at_edge = content[distance > EDGE_SHARE * edge_mm, 2]
    if len(at_edge) < MIN_EDGE_POINTS:
        return None
    level_mm = float(np.median(at_edge))
    inset_mm = float(np.clip(wall.radius_mm(level_mm) - edge_mm, *THICKNESS_MM))
    heap_mm = _mean_height(content) - level_mm

    def volume_ml(level: float, floor: float, inset: float, wall: _Wall) -> float:
        depth = max(level - floor, STEP_MM)
        # whole steps to the level: a last one beyond it would be content too
        step = depth / np.ceil(depth / STEP_MM)
        heights = floor + np.arange(step / 2, depth, step)
        radii = np.maximum(wall.radius_mm(heights) - inset, 0.0)
        top = np.pi * max(float(wall.radius_mm(level)) - inset, 0.0) ** 2
        return ml_from_mm3(float((np.pi * radii**2).sum()) * step + top * heap_mm)

    content_ml = volume_ml(level_mm, floor_mm, inset_mm, wall)
    changes = [
        volume_ml(level_mm, floor_mm, inset_mm + THICKNESS_SD_MM, wall) - content_ml,
        volume_ml(level_mm + LEVEL_SD_MM, floor_mm, inset_mm, wall) - content_ml,
        volume_ml(level_mm, floor_mm + floor_sd_mm, inset_mm, wall) - content_ml,
    ]
    for foot, power in np.linalg.cholesky(wall.covariance).T:
        moved = replace(
            wall, foot_share=min(wall.foot_share + foot, 1.0), power=max(wall.power + power, 0.1)
        )
        changes.append(volume_ml(level_mm, floor_mm, inset_mm, moved) - content_ml)
    depth_mm = max(level_mm - floor_mm, STEP_MM)

    def inner_mm(height_mm: Float64Array | float) -> Float64Array:
        return wall.radius_mm(floor_mm + height_mm) - inset_mm

    slices = tuple(
        disc(
            low, min(low + SLICE_MM, depth_mm), vessel.centre_mm, max(float(inner_mm(low)), STEP_MM)
        )
        for low in np.arange(0.0, depth_mm, SLICE_MM).tolist()
    )
    rings_mm = np.linspace(0.0, depth_mm, int(np.ceil(depth_mm / STEP_MM)) + 1)
    shape = turned(vessel.centre_mm, inner_mm(rings_mm), rings_mm, heap_mm)
    return BowlContent(content_ml, float(np.sqrt(np.square(changes).sum())), slices, shape)


@dataclass(frozen=True, slots=True)
class _Wall:
    """Outer radius foot + (rim - foot) (z / rim_mm)^power at height z over the table. covariance: of foot and power."""

    rim_mm: float
    rim_radius_mm: float
    foot_share: float
    power: float
    covariance: Float64Array

    def radius_mm(self, height_mm: Float64Array | float) -> Float64Array:
        up = np.clip(np.asarray(height_mm) / self.rim_mm, 0.0, 1.0) ** self.power
        return np.asarray(
            self.rim_radius_mm * (self.foot_share + (1 - self.foot_share) * up), np.float64
        )


def _fit_wall(vessel: Vessel, table_mm: float) -> _Wall:
    """Maximum a posteriori of foot and power: what of the wall is seen, and what bowls are like."""
    rim_mm = vessel.rim_mm - table_mm
    wall = vessel.wall_mm.reshape(-1, 2) - [table_mm, 0.0]
    wall = wall[(wall[:, 0] > 0) & (wall[:, 0] < rim_mm)]
    prior = np.array([FOOT_SHARE, POWER])

    def residual(unknowns: Float64Array) -> Float64Array:
        foot, power = unknowns
        radii = _Wall(rim_mm, vessel.radius_mm, foot, power, np.eye(2)).radius_mm(wall[:, 0])
        return np.concatenate(
            [(radii - wall[:, 1]) / WALL_SD_MM, (unknowns - prior[:, 0]) / prior[:, 1]]
        )

    solution = scipy.optimize.least_squares(
        residual, prior[:, 0], bounds=([0.1, 0.1], [1.0, 2.0]), loss="soft_l1"
    )
    covariance = np.linalg.inv(solution.jac.T @ solution.jac)
    return _Wall(rim_mm, vessel.radius_mm, float(solution.x[0]), float(solution.x[1]), covariance)


def _mean_height(points: Float64Array) -> float:
    """Mean over cells of the top, each the median of its points."""
    cells = np.floor(points[:, :2] / CELL_MM).astype(np.int64)
    _, index = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(index.ravel(), kind="stable")
    starts = np.flatnonzero(np.diff(index.ravel()[order], prepend=-1))
    return float(np.mean([np.median(part) for part in np.split(points[order, 2], starts[1:])]))
