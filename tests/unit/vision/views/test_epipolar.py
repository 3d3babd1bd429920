from dataclasses import replace

import numpy as np

from app.vision.views.epipolar import good_matches, projection_matrix
from app.vision.views.features import ALIGNED_SIDE_PX, Matches
from tests.unit.vision.stereo_scene import blank_views


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


def test_wrong_matches_are_told_from_good_ones():
    first, second = blank_views()
    matches = matches_of(first, second)
    wrong = np.random.default_rng(2).uniform(0, 800, (12, 2))
    matches = replace(matches, second_px=np.concatenate([matches.second_px[:-12], wrong]))
    is_good, distances_px = good_matches(first, second, matches)
    assert is_good[:-12].all()
    assert is_good[-12:].mean() < 0.3  # by chance near their lines
    assert np.median(distances_px[is_good]) < 0.1


def test_a_small_photograph_is_no_sharper_than_its_pixels():
    first, second = blank_views()
    matches = matches_of(first, second)
    off = matches.second_px + np.array([0.0, 1.4])
    assert max(first.camera.width, first.camera.height) < ALIGNED_SIDE_PX
    assert good_matches(first, second, replace(matches, second_px=off))[0].all()
