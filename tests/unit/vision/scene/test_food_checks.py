"""What ends at another food or a vessel is whole; what ends at the border of what is seen is not."""

import numpy as np

from app.vision.scene.food_checks import is_food
from tests.unit.vision.scene.scenes import plain_scene

SHAPE = (200, 240)
ROWS, COLUMNS = np.indices(SHAPE)


def scene_of(height_mm):
    return plain_scene(
        SHAPE,
        height_mm=height_mm.astype(np.float32),
        points_table=np.zeros((*SHAPE, 3), np.float32),
        plane_xy_mm=np.zeros((*SHAPE, 2), np.float32),
        camera_mm=np.array([0.0, 0.0, 400.0]),
    )


DISC = (ROWS - 100) ** 2 + (COLUMNS - 60) ** 2 < 40**2
CUT = DISC & (COLUMNS < 75)  # a third of it lies behind what begins there
BEYOND = COLUMNS >= 75


def test_food_that_ends_at_a_vessel_is_food_and_where_nothing_is_seen_is_none():
    scene = scene_of(np.where(CUT, 50.0, 0.0))
    assert is_food(CUT, CUT, scene, np.zeros(SHAPE, bool))
    assert not is_food(CUT, CUT, scene, BEYOND)
