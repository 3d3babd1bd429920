"""Whether nothing moved: tables at the marker's height and not, matches on their lines and not."""

import numpy as np
import pytest

from app.vision.marker_spec import PlainBoard
from app.vision.views.features import Matches
from app.vision.views.relative_pose import RefinedViews
from app.vision.views.stillness import judge_heights, judge_matches, judge_table
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.views.test_epipolar import project

SPEC = PlainBoard(9, 7, 11.0)


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


@pytest.mark.parametrize("height_mm", [4.0, -4.0, np.nan])
def test_table_at_the_marker_or_unseen_is_still_whatever_stands_beside_or_far_from_it(height_mm):
    assert judge_table(SPEC, *table(height_mm)) is None
    plane, points = table(0.0)
    points[..., 2][plane[..., 0] > 65.0] = 18.0  # a plate
    assert judge_table(SPEC, plane, points) is None
    plane, points = table(40.0)
    points[(np.abs(plane[..., :2]) < 115.0).all(axis=-1), 2] = 0.0
    assert judge_table(SPEC, plane, points) is None


def test_foods_beside_the_marker_on_a_plain_table_are_no_table_that_moved():
    plane, points = table(np.nan)
    points[..., 2][plane[..., 0] > 60.0] = 37.0
    assert judge_table(SPEC, plane, points) is None


@pytest.mark.parametrize(("height_mm", "word"), [(20.0, "20 mm over"), (-12.0, "12 mm under")])
def test_table_over_or_under_the_marker_was_moved(height_mm, word):
    failure = judge_table(SPEC, *table(height_mm))
    assert failure.code == "scene_moved"
    assert word in failure.message
    assert failure.advice


@pytest.mark.parametrize(("good", "is_still"), [(100, True), (30, True), (20, False), (2, False)])
def test_matches_beside_the_board_lie_on_their_lines_or_were_moved(good, is_still):
    found = matches(100)
    is_good = np.arange(148) < 48 + good
    failure = judge_matches(found, is_good, placed_by="marker")
    assert (failure is None) == is_still
    if not is_still:
        assert (failure.code, bool(failure.advice)) == ("scene_moved", True)
        by_rig = judge_matches(found, is_good, placed_by="rig")
        assert by_rig.code == "rig_mismatch"
        assert "moved" not in by_rig.message
    assert judge_matches(matches(19), np.arange(67) < 48, placed_by="marker") is None  # few


def refined_and_matches(heights_mm):
    """Views with matches at these heights around the marker, every one sure."""
    views, rng = blank_views(), np.random.default_rng(0)
    points = np.column_stack([rng.uniform(60, 220, len(heights_mm)), rng.uniform(-90, 90, len(heights_mm)), heights_mm])
    pixels = [project(view, points) for view in views]
    beside = np.zeros(len(points), bool)
    return RefinedViews(*views, np.zeros(3), len(points)), Matches(*pixels, beside, ~beside)


HEIGHTS_MM = {
    "a meal": (np.linspace(0, 60, 60), True),
    "a plaque whose thickness nobody announced": (np.full(60, -12.0), True),
    "some wrong matches of a cloth's pattern": (np.r_[np.zeros(54), np.full(6, -80.0)], True),
    "a table under the marker": (np.r_[np.linspace(-5, 10, 40), np.full(20, -18.0)], False),
    "too few to judge by": (np.full(12, -40.0), True),
    "none": (np.empty(0), True),
}


@pytest.mark.parametrize(("heights_mm", "is_still"), HEIGHTS_MM.values(), ids=HEIGHTS_MM)
def test_much_under_the_marker_was_moved(heights_mm, is_still):
    failure = judge_heights(*refined_and_matches(heights_mm))
    assert (failure is None) == is_still
    if failure is not None:
        assert failure.code == "scene_moved"
        assert "18 mm under" in failure.message
