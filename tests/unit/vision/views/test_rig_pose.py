"""A rig's relative pose adjusted by matches: what they tell is mended, what they cannot tell stays a doubt."""

from dataclasses import replace

import cv2
import numpy as np

from app.vision.model import PhotoPair
from app.vision.views.features import Matches, triangulate
from app.vision.views.pose_doubt import volume_doubt
from app.vision.views.rig_pose import TURN_SD_RAD, refine_rig, views_of_rig
from tests.unit.vision.rigs import rig_of
from tests.unit.vision.stereo_scene import blank_views, rendered_views
from tests.unit.vision.views.test_epipolar import project

CUBE_POINTS = np.zeros((1, 3), np.float32)


def without_marker(view):
    return replace(view, marker=None)


def table_matches(first, second, count=200, seed=0):
    """Matches of points on the table and over it."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-60, 180, count), rng.uniform(-80, 80, count), np.zeros(count)])
    points[: count // 5, 2] = rng.uniform(10, 60, count // 5)
    is_food = points[:, 2] > 8
    return points, Matches(project(first, points), project(second, points), np.zeros(count, np.bool_), is_food)


def turned(view, degrees):
    turn = cv2.Rodrigues(np.radians(degrees))[0]
    return replace(view, rotation=turn @ view.rotation, translation_mm=turn @ view.translation_mm)


def test_second_camera_that_turned_about_the_baseline_is_turned_back():
    first, second = map(without_marker, blank_views())
    points, matches = table_matches(first, second)
    exact = triangulate(first, second, matches.first_px, matches.second_px)
    assert np.allclose(exact, points, atol=1e-6)
    off = turned(second, np.array([0.04, 0.0, 0.0]))  # rows lie 0.8 px apart
    refined = refine_rig(first, off, matches)
    seen = triangulate(refined.first, refined.second, matches.first_px, matches.second_px)
    before = triangulate(first, off, matches.first_px, matches.second_px)
    assert refined.matches == len(points)
    assert np.abs(seen[:, 2] - points[:, 2]).max() < 0.3
    assert np.abs(seen[:, 2] - points[:, 2]).mean() < np.abs(before[:, 2] - points[:, 2]).mean()


def test_without_matches_the_calibration_stands_with_its_doubt():
    first, second = map(without_marker, blank_views())
    no_matches = Matches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.bool_), np.empty(0, np.bool_))
    refined = refine_rig(first, second, no_matches)
    assert refined.matches == 0
    assert np.allclose(refined.second.rotation, second.rotation)
    # a turn about the vertical shifts all disparities by f x angle, which is what depth is read from
    disparity_rad = 60.0 / 330.0
    assert volume_doubt(refined, CUBE_POINTS).sd > TURN_SD_RAD / disparity_rad


def test_one_photograph_sent_twice_is_refused():
    left, right = rendered_views(None)
    failure = views_of_rig(PhotoPair(left.photo, left.photo), rig_of(left, right), np.random.default_rng(0))
    assert failure.code == "same_photograph"
