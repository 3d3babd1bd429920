from dataclasses import replace

import numpy as np
import pytest

from app.vision.geometry.topview import TableTrend
from app.vision.views.reconstruction import plane_points
from app.vision.views.rectification import rectify_by_poses, to_rectified_px
from app.vision.views.sight import Sight, sight_of
from tests.unit.vision.stereo_scene import CAMERA, look_at, view_of
from tests.unit.vision.views.test_epipolar import project as photographed

POSES = [look_at(centre, (60.0, 0.0, 10.0)) for centre in ((30.0, -260.0, 310.0), (90.0, -250.0, 345.0))]
# Cameras of different heights: the plane's disparity then changes along the rows too.
VIEWS = [view_of(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), pose) for pose in POSES]
PAIR = rectify_by_poses(*VIEWS)
DRIFT = (0.7, -3e-4, 5e-4)
WINDOW = (slice(300, 500), slice(400, 700))


def points(count=40, seed=0):
    return np.random.default_rng(seed).uniform([20, -50, 0], [140, 50, 60], (count, 3))


def flat_trend(*coefficients):
    return TableTrend(np.array([*coefficients, *[0.0] * (6 - len(coefficients))]), 0.1)


@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), DRIFT], ids=["no drift", "drift"])
def test_points_invert_project(drift):
    sight = Sight(PAIR, drift)
    assert np.allclose(sight.points(*sight.project(points())), points(), atol=1e-8)


def test_parallax_is_what_lies_between_both_photographs_of_a_point():
    sight = Sight(PAIR)
    pixels, parallax = sight.project(points())
    first, second = (to_rectified_px(PAIR, view, photographed(view, points())) for view in VIEWS)
    assert np.allclose(pixels, first, atol=1e-6)
    a, b, c = PAIR.plane_px
    sheared = (second[:, 0] + b * second[:, 1] + c) / (1 - a)
    assert np.allclose(sight.in_view(pixels, parallax, 1), np.column_stack([sheared, second[:, 1]]), atol=1e-6)
    assert np.array_equal(sight.in_view(pixels, parallax, 0), pixels)
    on_plane = points() * [1, 1, 0]
    assert np.allclose(sight.project(on_plane)[1], 0.0, atol=1e-9)
    assert (sight.project(on_plane + np.array([0, 0, 5.0]))[1] > 0).all()
    for place_mm, view in zip(sight.cameras_mm, VIEWS, strict=True):
        assert np.allclose(place_mm, view.centre_mm)
    twice = replace(PAIR, first_centre_mm=2 * PAIR.first_centre_mm, baseline_mm=2 * PAIR.baseline_mm)
    for one, two in zip((pixels, parallax), Sight(twice).project(2 * points()), strict=True):
        assert np.allclose(one, two)


@pytest.mark.parametrize("view", [0, 1])
def test_pixel_gradient_is_that_of_differences(view):
    sight, step = Sight(PAIR), 1e-3
    gradient = sight.pixel_gradient(points(), view)
    for axis in range(3):
        move = step * np.eye(3)[axis]
        there, back = (sight.in_view(*sight.project(points() + side * move), view) for side in (1, -1))
        assert np.allclose(gradient[:, :, axis], (there - back) / (2 * step), atol=1e-6)


def test_parallax_per_mm_is_that_of_differences_along_the_ray():
    sight, step = Sight(PAIR), 1e-3
    rays = points() - PAIR.first_centre_mm
    rays /= (rays @ PAIR.rotation[2])[:, None]
    there, back = (sight.project(points() + side * step * rays)[1] for side in (1, -1))
    depth = PAIR.project(points())[:, 2]
    assert np.allclose(sight.parallax_per_mm(depth), (there - back) / (2 * step), rtol=1e-5)


def test_drift_is_the_parallax_that_a_tilted_table_shows():
    trend = flat_trend(1.5, 0.8, -0.6)
    sight = sight_of(PAIR, trend, plane_points(PAIR, WINDOW)[..., :2], WINDOW)
    middle = np.array([[550.0, 400.0]])
    on_plane = Sight(PAIR).points(middle, np.zeros(1))
    lifted = np.column_stack([on_plane[:, :2], trend.height_mm(on_plane[:, :2])])
    seen, parallax = Sight(PAIR).project(lifted)
    # The ray to a point some mm higher meets the plane elsewhere by about as much.
    assert np.allclose(sight.drift_px(seen), parallax, rtol=0.02)
    level = sight_of(PAIR, flat_trend(), plane_points(PAIR, WINDOW)[..., :2], WINDOW)
    assert np.allclose(level.drift, 0.0, atol=1e-9)
    nowhere = np.full((*PAIR.shape, 2), np.nan, np.float32)  # beyond the horizon
    assert sight_of(PAIR, flat_trend(1.0), nowhere, WINDOW).drift == (0.0, 0.0, 0.0)
