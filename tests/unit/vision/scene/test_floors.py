from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.geometry.topview import TableTrend, TopView
from app.vision.scene.dish import Dish
from app.vision.scene.floors import with_floor
from app.vision.scene.plane_sweep import PlaneSweep
from app.vision.views.rectification import RectifiedPair
from app.vision.views.sight import Sight
from tests.unit.vision.scene.scenes import plain_scene

SHAPE = (240, 240)  # of a reduced grid, a millimetre a pixel
CAMERA_MM, DISPARITY_PX = 500.0, 60.0
RIM_MM, TABLE_MM = 12.0, 1.5
TABLE = TableTrend(np.array([TABLE_MM, 0, 0, 0, 0, 0]), 0.3)
VIEW = TopView(np.zeros(2), 3.0, np.zeros((80, 80), np.float32), np.zeros((80, 80), np.int64))


def grain(seed):
    noise = np.random.default_rng(seed).normal(0, 1, SHAPE).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.2)


def seen_at(height_mm, first):
    """Return the second camera's picture of a plane, given the first's. height_mm: over the marker's plane"""
    parallax = DISPARITY_PX * height_mm / (CAMERA_MM - height_mm)
    shift = np.array([[1.0, 0.0, -parallax], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(first, shift, SHAPE[::-1], borderMode=cv2.BORDER_REFLECT)


def scene_of(second, first, **fields):
    sweep = PlaneSweep((first, second), (0.0, 0.0, DISPARITY_PX), CAMERA_MM)
    return plain_scene(SHAPE, sweep=sweep, camera_mm=np.array([120.0, 120.0, CAMERA_MM]), **fields)


def dish_of(rim_mm=RIM_MM, radius_mm=110.0):
    inward = radius_mm - np.linalg.norm(VIEW.centres_mm() - 120.0, axis=-1)
    return Dish(inward.astype(np.float32), rim_mm, centre_mm=np.array([120.0, 120.0]), radius_mm=radius_mm)


@pytest.mark.parametrize("top_mm", [11.0, 13.5, 16.0])
def test_dish_whose_grain_lies_as_high_as_its_rim_is_a_board(top_mm):
    first = grain(0)
    board = with_floor(dish_of(), scene_of(seen_at(TABLE_MM + top_mm, first), first), VIEW, TABLE)
    assert board.floor_mm == board.rim_mm == pytest.approx(top_mm, abs=1.0)
    assert 0.0 < board.floor_sd_mm < 2.0


def test_dish_whose_floor_lies_lower_or_is_plain_is_a_plate():
    first = grain(0)
    low = scene_of(seen_at(TABLE_MM + 3.0, first), first)
    plain = scene_of(grain(1), first)  # the views' noise has nothing in common
    white = scene_of(np.full(SHAPE, 255, np.float32), np.full(SHAPE, 255, np.float32))
    for scene in (low, plain, white, replace(plain, sweep=None)):
        plate = with_floor(dish_of(), scene, VIEW, TABLE)
        assert (plate.floor_mm, plate.rim_mm) == (0.0, RIM_MM)


def test_bowl_is_no_board_however_level_its_content_is():
    first = grain(0)
    bowl = dish_of(rim_mm=50.0)
    assert with_floor(bowl, scene_of(seen_at(TABLE_MM + 50.0, first), first), VIEW, TABLE) is bowl


def test_food_on_a_plate_does_not_make_it_a_board():
    first = grain(0)
    rows, columns = np.indices(SHAPE)
    food = np.hypot(rows - 120, columns - 120) < 85  # its flank lies as high as a board's top would
    second = np.where(food, seen_at(TABLE_MM + 13.0, first), grain(1))
    height = np.where(food, 30.0, np.nan).astype(np.float32)
    assert with_floor(dish_of(), scene_of(second, first), VIEW, TABLE).floor_mm > 0  # where no height tells of it
    assert with_floor(dish_of(), scene_of(second, first, height_mm=height), VIEW, TABLE).floor_mm == 0


def test_one_quarter_alone_makes_no_board():
    first = grain(0)
    rows, columns = np.indices(SHAPE)
    high = seen_at(TABLE_MM + 13.0, first)  # pale food on a plate of its colour
    second = np.where((rows > 120) & (columns > 120), high, grain(1))
    assert with_floor(dish_of(), scene_of(second, first), VIEW, TABLE).floor_mm == 0
    second = np.where((rows > 120) | (columns > 120), high, grain(1))  # the fourth is hidden
    assert with_floor(dish_of(), scene_of(second, first), VIEW, TABLE).floor_mm == pytest.approx(13.0, abs=1.0)


def test_slanted_pairs_planes_are_told_as_points_on_them_are_seen():
    rotation = cv2.Rodrigues(np.array([2.4, 0.2, -0.1]))[0]
    pair = RectifiedPair(
        first_bgr=np.random.default_rng(0).integers(0, 256, (360, 480, 3)).astype(np.uint8),
        second_bgr=None,
        is_seen=np.ones((360, 480), bool),
        first_map_px=np.zeros((360, 480, 2), np.float32),
        focal_px=600.0,
        centre_px=(240.0, 180.0),
        rotation=rotation,
        first_centre_mm=np.array([20.0, -300.0, 400.0]),
        baseline_mm=60.0,
        plane_px=tuple(np.array([*(-rotation[:2, 2] / 400.0 * 60.0), 0.0])),
        parallax_range_px=(0.0, 50.0),
    )
    a, b, _ = pair.plane_px
    c = 600.0 * 60.0 * -rotation[2, 2] / 400.0 - a * 240.0 - b * 180.0
    pair = replace(pair, plane_px=(a, b, float(c)))
    assert PlaneSweep.of_pair(pair, 2) is None
    on_plane = np.array([[0.0, 0.0, 14.0], [80.0, 10.0, 14.0], [20.0, 90.0, 14.0]])
    pixels, parallax = Sight(pair).project(on_plane)
    along, down, rest = np.linalg.solve(np.column_stack([pixels, np.ones(3)]), parallax)
    back = np.array([[1.0 / (1.0 - along), down / (1.0 - along), rest / (1.0 - along)], [0.0, 1.0, 0.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    second = cv2.warpAffine(pair.first_bgr, back, (480, 360), flags=flags)
    sweep = PlaneSweep.of_pair(replace(pair, second_bgr=second), 2)
    area = np.zeros((180, 240), bool)
    area[60:120, 80:160] = True
    heights = np.arange(0.0, 30.0, 1.0)
    assert heights[sweep.log_likelihoods(area, heights).argmax()] == pytest.approx(14.0, abs=1.0)
    assert not sweep.log_likelihoods(np.zeros_like(area), heights).any()
