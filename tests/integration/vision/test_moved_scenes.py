"""Pairs whose geometry does not hold: a failure with advice, or none of the volumes that nonsense would give."""

import cv2
import pytest

from app.vision.model import PhotoPair
from tests.support.scenes import as_jpeg, changed, load_scene, with_food_moved, with_marker_moved

NOT_MEASURED = {"scene_moved", "too_few_matches", "pose_unreliable", "no_food_found", "food_not_measured"}
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def apple(shared_data):
    cv2.setNumThreads(1)
    return load_scene(shared_data, "apple-1")


@pytest.fixture(scope="module")
def salad(shared_data):
    return load_scene(shared_data, "meal-01")


def assert_not_measured(estimate, codes=NOT_MEASURED):
    assert estimate.failure is not None, [(item.volume_ml, item.flags) for item in estimate.items]
    assert estimate.failure.code in codes
    assert estimate.failure.advice
    assert estimate.items == ()


def test_photographs_of_two_meals_are_not_measured(apple, salad, shared_data):
    others = {"baseline_too_large", *NOT_MEASURED}
    assert_not_measured(
        apple.estimate(PhotoPair(apple.pair.left, load_scene(shared_data, "apple-2").pair.right)), others
    )
    assert_not_measured(apple.estimate_by_exif(PhotoPair(apple.pair.left, salad.pair.right)), others)


def test_photograph_encoded_again_is_no_second_one(apple):
    again = changed(apple.pair.left, as_jpeg(70))
    estimate = apple.estimate(PhotoPair(apple.pair.left, again))
    assert_not_measured(estimate, {"same_photograph", "baseline_too_small"})


@pytest.mark.parametrize("move", [(3, 2), (8, 5), (30, 0), (0, 30), (-6, 0), (0, 0, 0.15)])
def test_marker_pushed_or_turned_between_the_photographs_is_told(apple, move):
    # (3, 2) and (8, 5) go along the line between the cameras: every match stays on its epipolar line.
    assert_not_measured(apple.estimate(with_marker_moved(apple, *move)))


@pytest.mark.parametrize("move", [(3, 2), (12, -4)])
def test_marker_pushed_beside_a_full_plate_is_told(salad, move):
    assert_not_measured(salad.estimate(with_marker_moved(salad, *move)), {"scene_moved"})


@pytest.mark.parametrize("move", [(0, 20), (0, -20), (20, 0), (-20, 0), (50, 0)])
def test_food_pushed_between_the_photographs_is_not_measured(apple, move):
    assert_not_measured(apple.estimate(with_food_moved(apple, *move)))


@pytest.mark.parametrize("move", [(-20, 0), (20, 0), (0, 20), (0, -20), (0, 60), (0, 8)])
def test_foods_pushed_on_their_plate_are_not_measured(salad, move):
    """Not (8, 0) to (15, 0), along the line between the cameras: such food looks like food that is higher."""
    estimate = salad.estimate(with_food_moved(salad, *move))
    assert all(item.volume_ml is None for item in estimate.items)
    assert estimate.items or estimate.failure.code in NOT_MEASURED
