"""Outlines tidied by colour: what of the cloth hung on goes."""

import cv2
import numpy as np

from app.vision.scene.food_outline import tidy_outlines
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
