"""The table is found among the matches, and holds the poses that a small sheet leaves tilted."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.views.epipolar import surely_on_epipolar_lines
from app.vision.views.features import Matches, triangulate
from app.vision.views.relative_pose import refine_views
from app.vision.views.table_matches import matches_on_table
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.views.test_epipolar import project


def table_points(rng, count, height_mm=0.0):
    x, y = rng.uniform(60, 300, count), rng.uniform(-160, 160, count)
    return np.column_stack([x, y, np.full(count, height_mm)])


def food_points(rng, count):
    return np.column_stack([rng.uniform(120, 200, count), rng.uniform(-40, 40, count), rng.uniform(10, 60, count)])


def seen_by(views, points, noise_px=0.0, seed=3):
    rng = np.random.default_rng(seed)
    return [project(view, points) + rng.normal(0, noise_px, (len(points), 2)) for view in views]


def matches_with_noisy_corners(views, points, corner_px, seed=5):
    """Corners as a detector errs, and matches that do not."""
    rng = np.random.default_rng(seed)
    noisy, pixels = [], []
    for view, seen in zip(views, seen_by(views, points), strict=True):
        corners = view.marker.corners_px + rng.normal(0, corner_px, view.marker.corners_px.shape)
        noisy.append(replace(view, marker=replace(view.marker, corners_px=corners)))
        pixels.append(np.concatenate([corners, seen]))
    is_board = np.arange(len(pixels[0])) < len(pixels[0]) - len(points)
    return noisy, Matches(pixels[0], pixels[1], is_board, ~is_board)


def test_matches_on_the_table_are_told_from_those_on_food():
    views, rng = blank_views(), np.random.default_rng(0)
    points = np.concatenate([table_points(rng, 40), food_points(rng, 30)])
    table = matches_on_table(*views, [], *seen_by(views, points, 0.1))
    assert table.is_table[:40].mean() > 0.9
    assert not table.is_table[40:].any()
    assert abs(table.height_mm) < 0.5


@pytest.mark.parametrize(
    "points",
    [
        food_points(np.random.default_rng(1), 60),  # a plain table shows none
        table_points(np.random.default_rng(2), 60, height_mm=12.0),  # the top of a board
        np.concatenate([table_points(np.random.default_rng(4), n, z) for n, z in ((30, 0.0), (12, -15.0))]),
        table_points(np.random.default_rng(5), 10),
        np.empty((0, 3)),
    ],
    ids=["food alone", "a board's top", "much lies under it", "too few", "none"],
)
def test_no_table_is_taken_for_certain_where_none_is_seen(points):
    views = blank_views()
    assert matches_on_table(*views, [], *seen_by(views, points)) is None


def test_a_table_that_is_seen_levels_the_poses_far_from_the_sheet():
    views, rng = blank_views(), np.random.default_rng(6)
    far = np.array([[280.0, -120.0, 0.0], [280.0, 120.0, 0.0], [300.0, 0.0, 0.0]])

    def off_mm(points):
        errors = []
        for seed in range(6):
            noisy, matches = matches_with_noisy_corners(views, points, 0.3, seed)
            refined = refine_views(*noisy, matches)
            heights = triangulate(refined.first, refined.second, *seen_by(views, far))[:, 2]
            errors.append(np.abs(heights).max())
        return np.mean(errors)

    with_table = np.concatenate([food_points(rng, 30), table_points(rng, 40)])
    without = np.concatenate([food_points(rng, 30), table_points(rng, 40) + [0, 0, 1] * rng.uniform(15, 60, (40, 1))])
    assert off_mm(with_table) < 0.5
    assert off_mm(with_table) < 0.5 * off_mm(without)


def test_matches_off_by_a_pattern_that_repeats_are_left_out():
    views, rng = blank_views(), np.random.default_rng(7)
    first_px, second_px = seen_by(views, np.concatenate([table_points(rng, 60), food_points(rng, 20)]), 0.05)
    second_px[:12, 1] += 0.9  # 3 px of a 12-megapixel photograph, all to one side
    nothing = np.zeros(80, bool)
    kept = surely_on_epipolar_lines(*views, Matches(first_px, second_px, nothing, ~nothing))
    assert not kept[:12].any()
    assert kept[12:].all()
