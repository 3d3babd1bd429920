from dataclasses import replace

import numpy as np
import pytest

from app.vision.views.epipolar import (
    compare_fundamentals,
    fundamental_from_points,
    fundamental_from_projections,
    projection_matrix,
    symmetric_epipolar_distance_px,
)
from app.vision.views.features import ALIGNED_SIDE_PX, Matches
from tests.unit.vision.stereo_scene import SPEC, blank_views


def scene_points(count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([-60, -60, 0], [180, 80, 90], (count, 3))


def project(view, points):
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ projection_matrix(view).T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def matches_of(first, second, count=40, seed=0):
    points = scene_points(count, seed)
    corners = len(first.marker.corners_px)
    return Matches(
        np.concatenate([first.marker.corners_px, project(first, points)]),
        np.concatenate([second.marker.corners_px, project(second, points)]),
        np.r_[np.ones(corners, bool), np.zeros(count, bool)],
        np.r_[np.zeros(corners, bool), np.ones(count, bool)],
    )


def test_both_fundamentals_agree_on_exact_points():
    first, second = blank_views()
    points = scene_points(16)
    by_points = fundamental_from_points(project(first, points), project(second, points))
    by_views = fundamental_from_projections(projection_matrix(first), projection_matrix(second))
    assert min(np.abs(by_points - by_views).max(), np.abs(by_points + by_views).max()) < 1e-6
    x, x_second = 1000 * project(first, points), 1000 * project(second, points)  # in other units
    assert symmetric_epipolar_distance_px(fundamental_from_points(x, x_second), x, x_second).max() < 1e-3
    with pytest.raises(ValueError, match="8 pairs"):
        fundamental_from_points(x[:7], x_second[:7])


def test_wrong_matches_do_not_spoil_the_comparison():
    first, second = blank_views()
    matches = matches_of(first, second)
    wrong = np.random.default_rng(2).uniform(0, 800, (12, 2))
    matches = replace(matches, second_px=np.concatenate([matches.second_px[:-12], wrong]))
    found = compare_fundamentals(first, second, matches, np.random.default_rng(0))
    assert len(found.drawn) == 16
    assert found.matches_distance_px < 0.1
    assert found.views_distance_px < 0.1
    assert found.is_good[: len(matches) - 12].all()
    again, other = (compare_fundamentals(first, second, matches, np.random.default_rng(seed)).drawn for seed in (0, 5))
    assert np.array_equal(again, found.drawn)
    assert not np.array_equal(other, found.drawn)


def test_a_small_photograph_is_no_sharper_than_its_pixels():
    first, second = blank_views()
    matches = matches_of(first, second)
    off = matches.second_px + np.array([0.0, 1.4])
    found = compare_fundamentals(first, second, replace(matches, second_px=off), np.random.default_rng(0))
    assert max(first.camera.width, first.camera.height) < ALIGNED_SIDE_PX
    assert found.is_good.all()


def test_a_board_alone_gives_too_few_matches():
    first, second = blank_views()
    matches = matches_of(first, second, count=0)
    found = compare_fundamentals(first, second, matches, np.random.default_rng(0))
    assert found.code == "too_few_matches"
    assert len(matches) == (SPEC.columns - 1) * (SPEC.rows - 1)
