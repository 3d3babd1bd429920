import numpy as np
import pytest

from app.errors import Failure
from app.vision.segmentation import HintMask, segment_foods
from app.vision.support import support_height_mm

SHAPE = (420, 560)
PIXEL_MM = 0.5
PLATE_BGR, TABLE_BGR, FOOD_BGR = (215, 220, 222), (90, 120, 150), (40, 60, 190)


def disc(row, column, radius):
    rows, columns = np.indices(SHAPE)
    return np.hypot(rows - row, columns - column) < radius


class Meal:
    """Seen from straight above: heights and colours on a grid of half a millimetre."""

    def __init__(self, seed=0):
        self.height = np.zeros(SHAPE, np.float32)
        self.image = np.zeros((*SHAPE, 3), np.float64) + TABLE_BGR
        self.rng = np.random.default_rng(seed)

    def plate(self, flat_mm=3.0, rim_mm=14.0):
        self.height[disc(210, 280, 190)] = rim_mm
        self.height[disc(210, 280, 170)] = flat_mm
        self.image[disc(210, 280, 190)] = PLATE_BGR
        return self

    def food(self, row, column, radius, top_mm, colour=FOOD_BGR):
        rows, columns = np.indices(SHAPE)
        reach = np.hypot(rows - row, columns - column) / radius
        dome = top_mm * np.sqrt(np.clip(1 - reach**2, 0, 1))
        self.height = np.maximum(self.height, dome.astype(np.float32))
        self.image[reach < 1] = colour
        return self

    def segment(self, hints=(), ignored=None):
        rows, columns = np.indices(SHAPE)
        heights = self.height + self.rng.normal(0, 0.4, SHAPE)
        points = np.stack([columns * PIXEL_MM, rows * PIXEL_MM, heights], -1).astype(np.float32)
        image = np.clip(self.image + self.rng.normal(0, 4, self.image.shape), 0, 255).astype(np.uint8)
        ignored = np.zeros(SHAPE, bool) if ignored is None else ignored
        return segment_foods(image, points, PIXEL_MM, ignored, hints)


def iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def test_food_on_a_plate_is_found_and_the_rim_is_not():
    found = Meal().plate().food(200, 260, 60, 45.0).segment()
    assert len(found) == 1
    assert iou(found[0].mask, disc(200, 260, 60)) > 0.9


def test_two_foods_on_the_bare_table_are_two():
    found = Meal().food(150, 150, 60, 40.0).food(260, 400, 45, 30.0, (60, 200, 220)).segment()
    assert len(found) == 2
    assert iou(found[0].mask, disc(150, 150, 60)) > 0.85
    assert iou(found[1].mask, disc(260, 400, 45)) > 0.85


def test_empty_plate_gives_no_food_found():
    found = Meal().plate().segment()
    assert isinstance(found, Failure)
    assert found.code == "no_food_found"


def test_bare_table_gives_no_food_found():
    assert Meal().segment().code == "no_food_found"


def test_polygon_is_taken_as_it_is():
    drawn = disc(100, 100, 30)
    found = Meal().segment([HintMask(drawn, 4, is_exact=True)])
    assert found[0].hint == 4
    assert np.array_equal(found[0].mask, drawn)


def test_point_chooses_the_food_under_it():
    meal = Meal().food(150, 150, 60, 40.0).food(260, 400, 45, 30.0, (60, 200, 220))
    found = meal.segment([HintMask(disc(260, 400, 4), 0)])
    assert len(found) == 1
    assert iou(found[0].mask, disc(260, 400, 45)) > 0.85


def test_two_points_share_touching_foods():
    meal = Meal().food(200, 220, 50, 40.0).food(200, 310, 50, 40.0)
    found = meal.segment([HintMask(disc(200, 220, 4), 0), HintMask(disc(200, 310, 4), 1)])
    assert [region.hint for region in found] == [0, 1]
    assert not (found[0].mask & found[1].mask).any()
    assert iou(found[0].mask, disc(200, 220, 50)) > 0.75


def test_box_limits_the_food():
    box = np.zeros(SHAPE, bool)
    box[100:200, 100:160] = True
    found = Meal().food(150, 150, 60, 40.0).segment([HintMask(box, 0, is_box=True)])
    assert not (found[0].mask & ~box).any()


def test_what_is_ignored_is_no_food():
    meal = Meal().food(150, 150, 60, 40.0)
    assert meal.segment(ignored=disc(150, 150, 90)).code == "no_food_found"


@pytest.mark.parametrize("flat_mm", [0.0, 3.0, 12.0])
def test_support_is_the_flat_part_around_the_food(flat_mm):
    meal = Meal().plate(flat_mm=flat_mm, rim_mm=flat_mm + 10.0).food(210, 280, 60, 45.0)
    points = np.zeros((*SHAPE, 3), np.float32)
    points[..., 2] = meal.height
    found = support_height_mm(points, disc(210, 280, 60), np.zeros(SHAPE, bool))
    assert abs(found - flat_mm) < 0.5


def test_support_that_was_not_measured_is_none():
    points = np.full((*SHAPE, 3), np.nan, np.float32)
    assert support_height_mm(points, disc(210, 280, 60), np.zeros(SHAPE, bool)) is None
