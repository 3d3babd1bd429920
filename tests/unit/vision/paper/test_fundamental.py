import numpy as np
import pytest

from app.vision.geometry.projective import map_points
from app.vision.paper.fundamental import fundamental_from_points, rectify_by_fundamental
from app.vision.views.epipolar import (
    fundamental_from_projections,
    projection_matrix,
    symmetric_epipolar_distance_px,
)
from tests.unit.vision.stereo_scene import blank_views
from tests.unit.vision.views.test_epipolar import project, scene_points


def test_fundamental_of_exact_points_is_that_of_the_views():
    first, second = blank_views()
    points = scene_points(16)
    by_points = fundamental_from_points(project(first, points), project(second, points))
    by_views = fundamental_from_projections(projection_matrix(first), projection_matrix(second))
    assert min(np.abs(by_points - by_views).max(), np.abs(by_points + by_views).max()) < 1e-6
    x, x_second = 1000 * project(first, points), 1000 * project(second, points)  # in other units
    assert symmetric_epipolar_distance_px(fundamental_from_points(x, x_second), x, x_second).max() < 1e-3
    with pytest.raises(ValueError, match="8 pairs"):
        fundamental_from_points(x[:7], x_second[:7])


def test_rectification_by_fundamental_aligns_rows_and_drives_disparity_through_zero():
    first, second = blank_views()
    points = scene_points(40)
    x, x_second = project(first, points), project(second, points)
    homographies = rectify_by_fundamental(fundamental_from_points(x, x_second), x, x_second, (1200, 900))
    y, y_second = map_points(homographies[0], x), map_points(homographies[1], x_second)
    disparity = y[:, 0] - y_second[:, 0]
    # Half a second of arc at this focal length: the fundamental matrix is exact but for rounding.
    assert np.abs(y[:, 1] - y_second[:, 1]).max() < 1e-3
    assert disparity.min() < 0 < disparity.max()
    assert abs(disparity.mean()) < 1e-6
    cost = ((y - y_second) ** 2).sum()  # least: no shift or stretch betters it
    for change in ([1.001, 0.0, 0.0], [1.0, 0.001, 0.0], [1.0, 0.0, 0.5]):
        moved = np.column_stack([np.column_stack([y_second, np.ones(len(y))]) @ change, y_second[:, 1]])
        assert ((y - moved) ** 2).sum() >= cost
    inside = np.array([[0.0, -1.0, 450.0], [1.0, 0.0, -600.0], [-450.0, 600.0, 0.0]])  # [e]x, e = (600, 450, 1)
    assert rectify_by_fundamental(inside, np.zeros((8, 2)), np.zeros((8, 2)), (1200, 900)) is None
