"""What can be seen of a bowl: its rim's circle, and the outer wall where it faces the camera.

The dish found from above, the points -> rim in the table frame, and the wall as radius over height. What its inside
looks like is for those who measure the food in it.
"""

from dataclasses import dataclass

import numpy as np

from app.vision.geometry.topview import TableTrend, TopView
from app.vision.model import Float64Array
from app.vision.scene.dish import Dish
from app.vision.scene.scene import Scene

STEP_MM = 4.0  # of height
BELOW_RIM_MM = 4.0
OVER_TABLE_MM = 2.0
BEYOND_MM = 6.0  # outside the rim's circle: a wall leans inward downwards
MIN_POINTS = 20  # in a step


@dataclass(frozen=True, slots=True)
class Vessel:
    """A bowl. centre_mm: (2,) of the rim's circle, x, y; radius_mm: to the rim's top; rim_mm: over the marker's plane.

    wall_mm: (n, 2) height over the marker's plane and radius of the outer wall, upwards; n is 0 where none is seen.
    """

    centre_mm: Float64Array
    radius_mm: float
    rim_mm: float
    wall_mm: Float64Array


def describe_vessel(
    scene: Scene, view: TopView, dish: Dish | None, trend: TableTrend
) -> Vessel | None:
    """The bowl that the dish is; None if it is none."""
    if dish is None or not dish.is_deep or dish.centre_mm is None or dish.radius_mm is None:
        return None
    table_mm = float(trend.height_mm(dish.centre_mm))
    # Pixels outside the rim's ellipse, whose points yet lie within the rim's circle, show the outer wall.
    is_outside = dish.inward_at(view, scene.xy_at(dish.rim_mm)) < 0
    radius = np.linalg.norm(scene.points_table[..., :2] - dish.centre_mm, axis=-1)
    height = scene.height_mm
    is_wall = is_outside & (radius < dish.radius_mm + BEYOND_MM) & ~scene.is_ignored
    is_wall &= (height > OVER_TABLE_MM) & (height < dish.rim_mm - BELOW_RIM_MM)
    steps = np.floor(height[is_wall] / STEP_MM).astype(np.int64)
    rows = []
    for step in range(int(dish.rim_mm / STEP_MM) + 1):
        within = steps == step
        if np.count_nonzero(within) >= MIN_POINTS:
            rows.append(
                (
                    table_mm + float(np.median(height[is_wall][within])),
                    float(np.median(radius[is_wall][within])),
                )
            )
    return Vessel(
        dish.centre_mm, dish.radius_mm, table_mm + dish.rim_mm, np.array(rows).reshape(-1, 2)
    )
