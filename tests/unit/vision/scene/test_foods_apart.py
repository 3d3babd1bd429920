"""Touching foods: two balls ray-traced as a camera sees them, one in front of the other."""

import numpy as np
import pytest

from app.vision.scene.foods_apart import tell_apart
from tests.unit.vision.scene.scenes import plain_scene, slanting_rays

SHAPE = (200, 240)
CAMERA_MM = np.array([0.0, -400.0, 400.0])
FOCAL_PX = 420.0
FRONT_MM, BACK_MM = ((0.0, -20.0, 36.0), 36.0), ((22.0, 38.0, 30.0), 30.0)  # middle, radius
RED, BROWN = (62, 78, 146), (62, 90, 128)  # mottled more than they differ


def rays():
    direction = slanting_rays(SHAPE, FOCAL_PX)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def distance_to(ball):
    """(h, w) from the camera to a ball along each ray; NaN beside it."""
    middle, radius = ball
    apart = np.array(middle) - CAMERA_MM
    along = rays() @ apart
    square = radius**2 - (apart @ apart - along**2)
    return np.where(square > 0, along - np.sqrt(np.maximum(square, 0)), np.nan)


def photographed(front_mm, back_mm):
    """The mask (h, w) of both balls and the scene; distances (h, w) from the camera, NaN beside each."""
    rng = np.random.default_rng(3)
    is_front = np.isfinite(distance_to(FRONT_MM))
    food = is_front | np.isfinite(distance_to(BACK_MM))
    plane = CAMERA_MM + rays() * (-CAMERA_MM[2] / rays()[..., 2])[..., None]
    shown = np.where(is_front, front_mm, back_mm)
    points = np.where(food[..., None], CAMERA_MM + rays() * shown[..., None], plane).astype(np.float32)
    colour = np.where(is_front[..., None], RED, np.where(food[..., None], BROWN, (200, 200, 190)))
    mottled = colour + rng.normal(0.0, 12.0, (*SHAPE, 1)) + rng.normal(0.0, 4.0, (*SHAPE, 3))
    scene = plain_scene(
        SHAPE,
        image_bgr=np.clip(mottled, 0, 255).astype(np.uint8),
        height_mm=points[..., 2],
        points_table=points,
        plane_xy_mm=plane[..., :2].astype(np.float32),
        camera_mm=CAMERA_MM,
        pixel_mm=1.35,
    )
    return food, is_front, scene


def test_food_that_ends_in_front_of_another_one_is_told_apart():
    food, is_front, scene = photographed(distance_to(FRONT_MM), distance_to(BACK_MM))
    masks = tell_apart(food, scene)
    assert len(masks) == 2
    front = max(masks, key=np.count_nonzero)
    assert np.count_nonzero(front & is_front) > 0.97 * np.count_nonzero(front | is_front)


@pytest.mark.parametrize("distance_mm", [500.0, np.nan], ids=["one_surface", "unmeasured"])
def test_same_picture_without_a_step_is_one_food(distance_mm):
    everywhere = np.full(SHAPE, distance_mm)
    food, _, scene = photographed(everywhere, everywhere)
    assert len(tell_apart(food, scene)) == 1
