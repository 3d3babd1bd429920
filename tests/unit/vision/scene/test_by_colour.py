"""What lies on a table by its colour alone, under light and cloths that mislead."""

import cv2
import numpy as np

from app.vision.geometry.topview import TableTrend
from app.vision.scene.by_colour import lay_out_by_colour, places_by_colour
from tests.unit.vision.scene.scenes import iou, plain_scene

SHAPE = (400, 560)
PIXEL_MM = 1.6
SHEET = (150, 420)  # row and column of its middle
WOOD_BGR, FOOD_BGR = (92, 128, 176), (60, 108, 132)


def disc(row, column, radius):
    rows, columns = np.indices(SHAPE)
    return np.hypot(rows - row, columns - column) < radius


def things_on(table, foods=(), light=1.0):
    """(h, w) what is found. table: (h, w, 3) BGR as evenly lit; foods: masks with their colours."""
    rows, columns = np.indices(SHAPE)
    image = np.array(np.broadcast_to(table, (*SHAPE, 3)), np.float64)
    for mask, colour in foods:
        image[mask] = colour
    sheet = (abs(rows - SHEET[0]) < 40) & (abs(columns - SHEET[1]) < 40)
    image[sheet] = np.where(((rows // 8 + columns // 8) % 2 == 0)[..., None], 20, 250)[sheet]
    image = image * np.broadcast_to(light, SHAPE)[..., None] + np.random.default_rng(0).normal(0, 2, image.shape)
    plane = np.stack([columns - SHEET[1], SHEET[0] - rows], axis=-1).astype(np.float32) * PIXEL_MM
    scene = plain_scene(
        SHAPE,
        image_bgr=cv2.GaussianBlur(np.clip(image, 0, 255).astype(np.uint8), (0, 0), 0.8),
        reach_px=np.ones(SHAPE, np.float32),
        is_ignored=sheet,
        plane_xy_mm=plane,
        camera_mm=np.array([0.0, 0.0, 700.0]),
        pixel_mm=PIXEL_MM,
        texture=np.ones(SHAPE, np.float32),
    )
    layout = lay_out_by_colour(scene, TableTrend(np.zeros(6), 1.0))
    return np.any([place.is_sure for place in places_by_colour(layout, [])] or [np.zeros(SHAPE, bool)], axis=0)


def lamp(row, column, reach):
    """(h, w) the light of a lamp over the table: no course of second order."""
    rows, columns = np.indices(SHAPE)
    return (1 + ((rows - row) ** 2 + (columns - column) ** 2) / reach**2) ** -1.5


def test_table_far_from_the_sheet_under_a_lamp_is_no_thing():
    food = disc(190, 210, 28)
    assert iou(things_on(WOOD_BGR, [(food, (70, 200, 220))], 0.4 + 0.6 * lamp(190, 130, 400)), food) > 0.85


def test_food_little_unlike_the_table_is_found_beside_one_that_is_far_unlike():
    pale, dull = disc(210, 220, 32), disc(150, 225, 30)
    seen = things_on(WOOD_BGR, [(dull, FOOD_BGR), (pale, (150, 205, 235))])
    assert iou(seen, pale | dull) > 0.85


def test_squares_of_a_cloth_are_no_things():
    rows, columns = np.indices(SHAPE)
    is_red = (rows // 14 + columns // 14) % 2 == 0
    cloth = np.where(is_red[..., None], (60, 60, 190), (225, 225, 230))
    food = disc(190, 240, 40)
    assert iou(things_on(cloth, [(food, (40, 160, 90))]), food) > 0.7


def test_shadow_that_an_orange_colours_on_a_white_plate_is_no_part_of_it():
    plate, orange = disc(210, 200, 100), disc(210, 200, 26)
    cast, core = disc(228, 224, 30), disc(222, 215, 28)
    shadow = cast & ~orange
    foods = [
        (plate, (228, 232, 234)),
        (shadow, (150, 166, 176)),
        (core & ~orange, (96, 118, 138)),
        (orange, (30, 120, 215)),
    ]
    assert iou(things_on(WOOD_BGR, foods), orange) > 0.9


def test_dark_food_on_a_white_plate_is_not_taken_for_a_shadow():
    plate, plum = disc(210, 200, 100), disc(210, 200, 28)
    assert iou(things_on(WOOD_BGR, [(plate, (228, 232, 234)), (plum, (52, 38, 44))]), plum) > 0.9
