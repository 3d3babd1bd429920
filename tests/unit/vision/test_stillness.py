"""Whether nothing moved: tables at the marker's height and not, matches on their lines and not."""

import numpy as np
import pytest

from app.vision.features import Matches
from app.vision.marker_spec import MarkerSpec
from app.vision.stillness import judge_matches, judge_table

SPEC = MarkerSpec("plain", 9, 7, 11.0)


def table(height_mm):
    """A view straight from above, a pixel a millimetre: where lines of sight meet the marker's plane, and points."""
    x, y = np.meshgrid(np.arange(-150.0, 150.0), np.arange(150.0, -150.0, -1.0))
    plane = np.stack([x, y, np.zeros_like(x)], -1).astype(np.float32)
    points = plane.copy()
    points[..., 2] = height_mm
    return plane, points


def matches(beside, board=48):
    pixels = np.zeros((board + beside, 2))
    is_board = np.arange(board + beside) < board
    return Matches(pixels, pixels, is_board, is_board)


@pytest.mark.parametrize("height_mm", [0.0, 4.0, -4.0])
def test_table_at_the_marker_is_still(height_mm):
    assert judge_table(SPEC, *table(height_mm)) is None


@pytest.mark.parametrize(("height_mm", "word"), [(20.0, "20 mm over"), (-12.0, "12 mm under")])
def test_table_over_or_under_the_marker_was_moved(height_mm, word):
    failure = judge_table(SPEC, *table(height_mm))
    assert failure.code == "scene_moved"
    assert word in failure.message
    assert failure.advice


def test_plate_beside_the_marker_is_no_move():
    plane, points = table(0.0)
    points[..., 2][plane[..., 0] > 65.0] = 18.0
    assert judge_table(SPEC, plane, points) is None


def test_table_that_shows_nothing_is_not_judged():
    assert judge_table(SPEC, *table(np.nan)) is None


def test_what_is_far_from_the_marker_is_not_judged():
    plane, points = table(40.0)
    near = (np.abs(plane[..., :2]) < 115.0).all(axis=-1)
    points[near, 2] = 0.0
    assert judge_table(SPEC, plane, points) is None


@pytest.mark.parametrize(("good", "is_still"), [(100, True), (30, True), (20, False), (0, False)])
def test_matches_beside_the_board_lie_on_their_lines_or_were_moved(good, is_still):
    found = matches(100)
    is_good = np.arange(148) < 48 + good
    failure = judge_matches(found, is_good)
    assert (failure is None) == is_still
    if not is_still:
        assert (failure.code, bool(failure.advice)) == ("scene_moved", True)


def test_few_matches_are_not_judged():
    assert judge_matches(matches(19), np.arange(67) < 48) is None
