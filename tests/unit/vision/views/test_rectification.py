import numpy as np
import pytest

from app.vision.views.rectification import is_swapped, rectify_by_poses, to_rectified_px
from tests.unit.vision.stereo_scene import CAMERA, blank_views
from tests.unit.vision.views.test_epipolar import project, scene_points


@pytest.mark.parametrize("roll_deg", [0.0, 35.0, -90.0, 180.0])
def test_rows_align_and_disparity_is_focal_times_baseline_over_depth(roll_deg):
    views = blank_views(roll_deg=roll_deg)
    first, second = views[::-1] if is_swapped(*views) else views
    pair = rectify_by_poses(first, second)
    points = scene_points(30)
    x = to_rectified_px(pair, first, project(first, points))
    x_second = to_rectified_px(pair, second, project(second, points))
    depth = pair.project(points)[:, 2]
    assert np.allclose(x[:, 1], x_second[:, 1], atol=1e-6)
    assert np.allclose(x[:, 0] - x_second[:, 0], pair.focal_px * pair.baseline_mm / depth)
    assert np.allclose(pair.project(points)[:, :2], x, atol=1e-6)
    a, b, c = pair.plane_px
    on_table = pair.project(points * [1.0, 1.0, 0.0])
    assert np.allclose(a * on_table[:, 0] + b * on_table[:, 1] + c, pair.focal_px * pair.baseline_mm / on_table[:, 2])
    parallax = (pair.focal_px * pair.baseline_mm / depth - a * x[:, 0] - b * x[:, 1] - c) / (1 - a)
    assert pair.parallax_range_px[0] < parallax.min() < parallax.max() < pair.parallax_range_px[1]
    column, row = np.rint(x).astype(int).T
    # Half a grid pixel of rounding, in px of the photograph.
    assert np.abs(pair.first_map_px[row, column] - project(first, points)).max() < 1.5 * CAMERA.fx / pair.focal_px


@pytest.mark.parametrize(("roll_deg", "of_swapped"), [(0.0, True), (90.0, False), (-90.0, False)])
def test_swapped_views_are_told_from_ordered_ones_unless_one_is_above_the_other(roll_deg, of_swapped):
    left, right = blank_views(roll_deg=roll_deg)
    assert not is_swapped(left, right)
    assert is_swapped(right, left) == of_swapped
