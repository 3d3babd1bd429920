import cv2
import numpy as np
import pytest

from app.core.errors import Failure
from app.vision.scene.segmentation import HintMask, segment_foods
from app.vision.scene.support import support_height_mm
from app.vision.views.disparity import DisparityMap
from app.vision.views.rectification import RectifiedPair
from tests.unit.vision.scene.scenes import iou

SHAPE = (420, 560)
PIXEL_MM = 0.5
CAMERA_MM = 500.0  # over the table, looking straight down
PLATE_BGR, TABLE_BGR, FOOD_BGR = (215, 220, 222), (90, 120, 150), (40, 60, 190)
OTHER_BGR = (60, 200, 220)


def disc(row, column, radius):
    rows, columns = np.indices(SHAPE)
    return np.hypot(rows - row, columns - column) < radius


class Meal:
    """Seen from straight above: heights and colours on a grid of half a millimetre of the table."""

    def __init__(self, seed=0):
        self.height = np.zeros(SHAPE, np.float32)
        self.image = np.zeros((*SHAPE, 3), np.float64) + TABLE_BGR
        self.rng = np.random.default_rng(seed)

    def plate(self, flat_mm=3.0, rim_mm=14.0):
        self.height[disc(210, 280, 190)] = rim_mm
        self.height[disc(210, 280, 170)] = flat_mm
        self.image[disc(210, 280, 190)] = PLATE_BGR
        return self

    def board(self, top_mm=15.0):
        self.height[20:400, 60:500] = top_mm
        self.image[20:400, 60:500] = (120, 160, 190)
        return self

    def food(self, row, column, radius, top_mm, colour=FOOD_BGR):
        rows, columns = np.indices(SHAPE)
        reach = np.hypot(rows - row, columns - column) / radius
        dome = top_mm * np.sqrt(np.clip(1 - reach**2, 0, 1))
        self.height = np.maximum(self.height, dome.astype(np.float32))
        self.image[reach < 1] = colour
        return self

    def pair(self):
        focal = CAMERA_MM / PIXEL_MM
        rows, columns = np.indices(SHAPE)
        image = np.clip(self.image + self.rng.normal(0, 4, self.image.shape), 0, 255).astype(np.uint8)
        parallax = focal * 50.0 * (1.0 / (CAMERA_MM - self.height) - 1.0 / CAMERA_MM)  # its noise serves as grain
        seen_at = [each.astype(np.float32) for each in (columns + parallax, rows)]
        return RectifiedPair(
            first_bgr=image,
            second_bgr=cv2.remap(image, *seen_at, cv2.INTER_LINEAR),
            is_seen=np.ones(SHAPE, bool),
            first_map_px=np.stack([columns, rows], -1).astype(np.float32),
            focal_px=focal,
            centre_px=(SHAPE[1] / 2, SHAPE[0] / 2),
            rotation=np.diag([1.0, -1.0, -1.0]),
            first_centre_mm=np.array([0.0, 0.0, CAMERA_MM]),
            baseline_mm=50.0,
            plane_px=(0.0, 0.0, focal * 50.0 / CAMERA_MM),
            parallax_range_px=(-5.0, 60.0),
        )

    def points(self, pair):
        rows, columns = np.indices(SHAPE)
        heights = self.height + self.rng.normal(0, 0.4, SHAPE)
        depth = CAMERA_MM - heights
        x = (columns - pair.centre_px[0]) / pair.focal_px * depth
        y = -(rows - pair.centre_px[1]) / pair.focal_px * depth
        return np.stack([x, y, heights], -1).astype(np.float32)

    def segment(self, hints=(), ignored=None, unmeasured=None, *, coarse=np.s_[:0], is_complete=False, **options):
        pair = self.pair()
        disparity = DisparityMap(np.zeros(SHAPE, np.float32), np.full(SHAPE, 4.5, np.float32))
        disparity.reach_px[coarse] = 9.0
        ignored = np.zeros(SHAPE, bool) if ignored is None else ignored
        points = self.points(pair)
        if unmeasured is not None:
            points[unmeasured] = np.nan
        found = segment_foods(pair, disparity, points, ignored, hints, is_complete=is_complete, **options)
        return found if isinstance(found, Failure) else found.regions


@pytest.mark.parametrize(
    ("meal", "place", "least"),
    [
        (lambda: Meal().plate().food(200, 260, 60, 45.0), (200, 260, 60), 0.97),
        (lambda: Meal().board().food(200, 260, 60, 45.0), (200, 260, 60), 0.97),
        (lambda: Meal().plate(rim_mm=18.0).food(210, 280, 70, 16.0), (210, 280, 70), 0.9),
        (lambda: Meal().plate().food(210, 280, 60, 45.0, PLATE_BGR), (210, 280, 60), 0.8),
    ],
    ids=["plate", "board", "low food within a high rim", "food of the dish's colour"],
)
def test_food_on_a_dish_is_found_and_the_dish_is_not(meal, place, least):
    (food,) = meal().segment()
    assert iou(food.mask, disc(*place)) > least


def test_half_shaded_food_with_the_colours_of_its_board_is_found_whole():
    meal = Meal().board().food(200, 260, 60, 60.0)
    egg = disc(200, 260, 60)
    dark = np.sin(np.arange(SHAPE[1]) / 9) > 0.3  # the grain
    meal.image[20:400, 60:500] = np.where(dark[60:500, None], (84, 112, 133), (120, 160, 190))
    meal.image[egg] = (120, 160, 190)
    meal.image[egg & (np.arange(SHAPE[1]) > 250)] = (84, 112, 133)
    (food,) = meal.segment(coarse=disc(200, 260, 80))
    assert iou(food.mask, egg) > 0.7


def test_food_of_the_tables_colour_beside_one_of_another_is_found_by_its_heights():
    meal = Meal().food(150, 150, 60, 45.0).food(200, 330, 70, 45.0, TABLE_BGR)
    foods = meal.segment(coarse=disc(200, 330, 90))
    assert len(foods) == 2
    assert max(iou(food.mask, disc(200, 330, 70)) for food in foods) > 0.75


@pytest.mark.parametrize(
    ("meal", "ignored"),
    [
        (Meal, None),
        (lambda: Meal().plate(), None),
        (lambda: Meal().food(150, 150, 60, 40.0), (150, 150, 90)),
    ],
    ids=["bare table", "empty plate", "food that is ignored"],
)
def test_nothing_but_table_and_dish_is_no_food(meal, ignored):
    found = meal().segment(ignored=disc(*ignored) if ignored else None)
    assert found.code == "no_food_found"


def test_shadow_is_no_food():
    meal = Meal().plate().food(200, 260, 60, 45.0)
    shadow = disc(225, 300, 55) & ~disc(200, 260, 60)
    meal.image[shadow] *= 0.75
    (food,) = meal.segment()
    assert np.count_nonzero(food.mask & shadow) < 0.05 * np.count_nonzero(shadow)


def test_touching_foods_are_two():
    found = Meal().plate().food(210, 220, 55, 40.0).food(210, 325, 55, 40.0, OTHER_BGR).segment()
    assert len(found) == 2
    truth = [disc(210, 220, 55) & ~disc(210, 325, 55), disc(210, 325, 55)]
    assert min(max(iou(region.mask, mask) for region in found) for mask in truth) > 0.93
    assert len(Meal().plate().food(210, 220, 55, 40.0).food(210, 325, 55, 40.0).segment()) == 2  # of one colour as well


def test_food_of_two_lobes_with_one_in_shade_is_one():
    """Light alone differs: a face turned from the lamp, not another food, although the outline is dented."""
    meal = Meal().plate().food(210, 236, 60, 40.0).food(210, 324, 60, 40.0)
    lobes = disc(210, 236, 60) | disc(210, 324, 60)
    lit = np.array((70.0, 130.0, 170.0))
    meal.image[lobes] = lit
    meal.image[lobes & (np.arange(SHAPE[1]) > 280)] = lit * 0.6 ** (1 / 2.2)  # 60 % of the light, gamma 2.2
    assert len(meal.segment()) == 1
    meal = Meal().plate().food(210, 280, 70, 45.0)  # nor do two tones make two foods
    meal.image[disc(210, 280, 70) & (np.arange(SHAPE[1]) > 280)] = OTHER_BGR
    (food,) = meal.segment()
    assert iou(food.mask, disc(210, 280, 70)) > 0.95


def test_knife_and_napkin_beside_a_food_are_no_food():
    meal = Meal().food(150, 150, 60, 40.0)
    meal.height[300:320, 100:500], meal.image[300:320, 100:500] = 9.0, (180, 180, 180)
    meal.height[50:250, 350:540], meal.image[50:250, 350:540] = 1.5, (60, 160, 60)
    (food,) = meal.segment()
    assert iou(food.mask, disc(150, 150, 60)) > 0.95


def test_pale_block_beside_a_printed_pack_is_found_by_itself():
    """The pack dominates the colours that both teach together, and the block's are the table's."""
    meal = Meal()
    pack, block = np.zeros((2, *SHAPE), bool)
    pack[120:300, 100:300], block[150:260, 310:430] = True, True
    meal.height[pack], meal.image[pack] = 60.0, FOOD_BGR
    meal.image[pack & (np.arange(SHAPE[1]) > 200)] = OTHER_BGR
    meal.height[block], meal.image[block] = 35.0, np.array(TABLE_BGR) + 20.0
    middle = block & (np.arange(SHAPE[1]) > 340) & (np.arange(SHAPE[1]) < 400)
    regions = meal.segment(unmeasured=middle, coarse=block, has_judge=True)
    assert len(regions) == 2
    assert iou(regions[0].mask, pack) > 0.9
    assert iou(regions[1].mask, block) > 0.8


def test_low_printed_pack_is_no_board_with_its_print_upon_it():
    meal = Meal()
    pack = np.zeros(SHAPE, bool)
    pack[90:330, 120:440] = True
    meal.height[pack], meal.image[pack] = 22.0, FOOD_BGR
    meal.image[disc(210, 280, 70)] = OTHER_BGR
    (found,) = meal.segment()
    assert iou(found.mask, pack) > 0.9


def test_plate_with_a_partly_measured_rim_is_no_food():
    meal = Meal().plate(rim_mm=12.0).food(210, 280, 90, 45.0)
    rows, columns = np.indices(SHAPE)
    is_arc = np.cos(5 * np.arctan2(rows - 210, columns - 280)) > 0.2
    meal.height[disc(210, 280, 196) & ~disc(210, 280, 100)] = 12.0
    plain = disc(210, 280, 196) & ~disc(210, 280, 92) & ~(is_arc & ~disc(210, 280, 110))
    (food,) = meal.segment(unmeasured=plain)
    assert iou(food.mask, disc(210, 280, 90)) > 0.9


def two_foods():
    return Meal().food(150, 150, 60, 40.0).food(260, 400, 45, 30.0, OTHER_BGR)


def test_two_foods_are_found_and_a_hint_of_one_does_not_lose_the_other_unless_hints_are_complete():
    first, second = two_foods().segment()
    assert iou(first.mask, disc(150, 150, 60)) > 0.95
    assert iou(second.mask, disc(260, 400, 45)) > 0.95
    nowhere, drawn = HintMask(np.zeros(SHAPE, bool), 0), disc(260, 400, 42)
    assert [region.hint for region in two_foods().segment([nowhere])] == [None, None]
    assert two_foods().segment([nowhere], is_complete=True).code == "no_food_found"
    for hint in (HintMask(disc(260, 400, 4), 0), HintMask(drawn, 0, is_exact=True)):
        found = two_foods().segment([hint])
        assert [region.hint for region in found] == [0, None]
        if hint.is_exact:
            assert np.array_equal(found[0].mask, drawn)  # as it is
        assert iou(found[0].mask, disc(260, 400, 45)) > (0.85 if hint.is_exact else 0.93)
        assert iou(found[1].mask, disc(150, 150, 60)) > 0.93
    (alone,) = two_foods().segment([HintMask(disc(260, 400, 4), 4)], is_complete=True)
    assert alone.hint == 4
    assert iou(alone.mask, disc(260, 400, 45)) > 0.93


def box_around(mask):
    rows, columns = np.nonzero(mask)
    box = np.zeros(SHAPE, bool)
    box[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
    return box


def test_box_around_an_unmeasured_block_holds_that_block():
    meal = Meal()
    block = np.zeros(SHAPE, bool)
    block[100:220, 200:360] = True
    meal.height[block], meal.image[block] = 40.0, PLATE_BGR
    found = meal.segment([HintMask(box_around(block), 0, is_box=True)], unmeasured=block)
    assert iou(found[0].mask, block) > 0.95


def test_food_that_is_measured_at_its_edge_alone_or_nowhere_is_found_by_its_colour():
    meal = Meal().food(200, 260, 60, 45.0)
    (food,) = meal.segment(unmeasured=disc(200, 260, 52) & (np.arange(SHAPE[1]) < 300))
    assert iou(food.mask, disc(200, 260, 60)) > 0.9
    meal = Meal()
    meal.image[disc(210, 280, 50)] = FOOD_BGR
    found = meal.segment([HintMask(disc(215, 290, 4), 0)], unmeasured=disc(210, 280, 60))  # under a point
    assert iou(found[0].mask, disc(210, 280, 50)) > 0.9


def test_food_of_which_no_height_is_measured_is_left_for_forms_to_judge():
    meal, food, unmeasured = Meal().plate().food(200, 250, 50, 40.0), disc(200, 250, 50), disc(210, 280, 165)
    assert meal.segment(unmeasured=unmeasured).code == "no_food_found"
    (found,) = meal.segment(unmeasured=unmeasured, has_judge=True)
    assert found.is_by_colour
    assert iou(found.mask, food) > 0.9
    assert found.support.height_mm == pytest.approx(4.0, abs=2.0)
    assert meal.segment(unmeasured=unmeasured, has_judge=True, is_complete=True).code == "no_food_found"


def test_what_fills_a_bowl_is_not_proposed_by_its_colour():
    meal = Meal().plate(rim_mm=60.0)
    meal.image[disc(210, 280, 120)] = FOOD_BGR
    assert meal.segment(unmeasured=disc(210, 280, 165), has_judge=True).code == "no_food_found"


@pytest.mark.parametrize("flat_mm", [0.0, 12.0])
def test_support_is_the_flat_part_around_the_food(flat_mm):
    meal = Meal().plate(flat_mm=flat_mm, rim_mm=flat_mm + 10.0).food(210, 280, 60, 45.0)
    points = np.zeros((*SHAPE, 3), np.float32)
    points[..., 2] = meal.height
    found = support_height_mm(points, disc(210, 280, 60), np.zeros(SHAPE, bool))
    assert abs(found - flat_mm) < 0.5
    assert support_height_mm(np.full_like(points, np.nan), disc(210, 280, 60), np.zeros(SHAPE, bool)) is None
