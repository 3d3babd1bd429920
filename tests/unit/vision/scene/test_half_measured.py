"""Blobs whose middle shows no parallax: food where raised edges enclose them, paper where they enclose food."""

import numpy as np

from app.vision.scene.half_measured import enclosed_by_raised
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


def box(left, top, right, bottom):
    return (left <= COLUMNS) & (right > COLUMNS) & (top <= ROWS) & (bottom > ROWS)


def test_plain_paper_around_a_food_is_not_food():
    sheet, food = box(30, 30, 200, 170), box(90, 70, 140, 120)
    heights = np.where(food, 60.0, np.where(sheet, np.nan, 0.0))  # the food in the middle of it, raised on all sides
    assert not enclosed_by_raised(scene_of(heights), heights.astype(np.float32)).any()
