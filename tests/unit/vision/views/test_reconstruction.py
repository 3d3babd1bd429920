from dataclasses import replace

import numpy as np
import pytest

from app.vision.views.reconstruction import DepthModel, back_project, fit_depth_model, fit_to_marker, plane_points
from app.vision.views.rectification import rectify_by_poses
from app.vision.views.relative_pose import RefinedViews
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.views.test_epipolar import scene_points


def test_exact_tie_points_give_back_p_and_q():
    disparity = np.linspace(80.0, 160.0, 12)
    model = fit_depth_model(disparity, 3.5 + 60_000.0 / disparity)
    assert np.isclose(model.p_mm, 3.5)
    assert np.isclose(model.q_mm_px, 60_000.0)
    with pytest.raises(ValueError, match="tie points"):
        fit_depth_model(np.full(5, 100.0), np.full(5, 500.0))
    depth = DepthModel(0.0, 1000.0).depth_mm(np.array([[np.nan, 0.0, -1.0, 2.0]], np.float32))
    assert np.array_equal(depth, [[np.nan, np.nan, np.nan, 500.0]], equal_nan=True)


def test_checkerboard_of_ideal_views_gives_p_zero_and_q_focal_times_baseline():
    first, second = blank_views()
    pair = rectify_by_poses(first, second)
    model = fit_to_marker(pair, RefinedViews(first, second, np.zeros(3), 0))
    assert abs(model.p_mm) < 1e-6
    assert np.isclose(model.q_mm_px, pair.focal_px * pair.baseline_mm)
    assert np.nanmax(np.abs(plane_points(pair)[pair.is_seen][:, 2])) < 0.01


def test_back_projection_undoes_projection():
    first, second = blank_views(roll_deg=90.0)
    pair = rectify_by_poses(first, second)
    points = scene_points(20)
    x = pair.project(points)
    # A grid whose principal point is moved so that each point falls on a pixel's centre.
    for column, row, depth in x[:5]:
        moved = replace(pair, centre_px=(pair.centre_px[0] - column, pair.centre_px[1] - row))
        found = back_project(moved, np.array([[depth]], np.float32))[0, 0]
        assert np.abs(points - found).sum(axis=1).min() < 1e-2
