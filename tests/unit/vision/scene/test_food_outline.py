"""Outlines corrected by colour: what of the cloth hung on goes, what only looks like the support stays."""

import cv2
import numpy as np
import pytest

from app.vision.scene.food_outline import correct_outlines, tidy_outlines
from tests.unit.vision.scene.scenes import iou, plain_scene

SHAPE = (160, 220)
CHECK_PX = 12
WHITE, PINK, RED = (215, 220, 222), (150, 158, 190), (50, 52, 165)
CHEESE, RIND = (115, 185, 215), (65, 115, 150)


def gingham():
    rows, columns = (index // CHECK_PX % 2 for index in np.indices(SHAPE))
    return np.array([WHITE, PINK, RED], np.float64)[rows + columns]


def polygon(*corners):
    picture = np.zeros(SHAPE, np.uint8)
    cv2.fillPoly(picture, [np.array(corners, np.int32)], 1)
    return picture > 0


def scene(image, height_mm=np.nan):
    noisy = image + np.random.default_rng(0).normal(0, 4, image.shape)
    return plain_scene(
        SHAPE,
        image_bgr=np.clip(noisy, 0, 255).astype(np.uint8),
        height_mm=np.full(SHAPE, height_mm, np.float32),
        reach_px=np.full(SHAPE, 9.0, np.float32),
    )


def with_checks(food, least_share=0.3):
    """The food with the checks of the cloth that it covers in part."""
    out = food.copy()
    for row in range(0, SHAPE[0], CHECK_PX):
        for column in range(0, SHAPE[1], CHECK_PX):
            check = (slice(row, row + CHECK_PX), slice(column, column + CHECK_PX))
            out[check] |= food[check].mean() > least_share
    return out


def test_checks_of_a_cloth_that_hung_on_to_a_cheese_go():
    image = gingham()
    top, front = polygon((50, 80), (120, 25), (175, 80)), polygon((50, 80), (175, 80), (170, 118), (55, 118))
    image[top], image[front] = CHEESE, RIND
    food = top | front
    hung_on = with_checks(food)
    assert iou(hung_on, food) < 0.9
    assert iou(tidy_outlines(hung_on, scene(image), 0.0), food) > 0.98
    (corrected,) = correct_outlines([hung_on], scene(image), 0.0)
    assert iou(corrected, food) > 0.96


def with_spot(radius_px, off_middle_px):
    """An apple's disc with a spot of the table's colour, the spot, and the picture."""
    image = np.full((*SHAPE, 3), (150, 170, 190), np.float64)
    rows, columns = np.indices(SHAPE)
    food = np.hypot(rows - 75, columns - 100) < 45
    spot = np.hypot(rows - 75, columns - 100 - off_middle_px) < radius_px
    image[food & ~spot] = (90, 110, 235)
    return food, spot, image


def test_spot_of_the_tables_colour_in_a_food_whose_heights_are_unknown_is_the_foods():
    food, spot, image = with_spot(18, off_middle_px=20)
    (corrected,) = correct_outlines([food], scene(image), 0.0)
    assert np.count_nonzero(corrected & spot) > 0.95 * np.count_nonzero(spot)


@pytest.mark.parametrize(("hole_mm", "share_kept"), [(2.0, 0.0), (30.0, 1.0), (np.nan, 1.0)])
def test_hole_of_a_ring_is_opened_where_heights_confirm_it(hole_mm, share_kept):
    food, hole, image = with_spot(18, off_middle_px=0)
    heights = np.where(hole, hole_mm, np.where(food, 30.0, 0.0)).astype(np.float32)
    (corrected,) = correct_outlines([food], scene(image, heights), 0.0)
    assert np.count_nonzero(corrected & hole) / np.count_nonzero(hole) == pytest.approx(share_kept, abs=0.1)
    assert iou(corrected | hole, food) > 0.95
