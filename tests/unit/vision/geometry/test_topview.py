import numpy as np
import pytest

from app.vision.geometry.topview import TREND_MM, fit_table_trend, usable_points, view_from_above


def scattered(height_of, count=40000, reach=200.0, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-reach, reach, (count, 2))
    return np.column_stack([xy, height_of(xy[:, 0], xy[:, 1])]).astype(np.float32)


def test_median_height_of_each_cell_is_that_of_a_slow_reference():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0, 12, (300, 2)), rng.normal(5, 3, 300)]).astype(np.float32)
    view = view_from_above(points, points[:, 2], 3.0)
    cells = np.floor((points[:, :2] - view.origin_mm) / 3.0).astype(int)
    for row in range(view.height_mm.shape[0]):
        for column in range(view.height_mm.shape[1]):
            own = np.sort(points[(cells[:, 0] == column) & (cells[:, 1] == row), 2])
            assert view.count[row, column] == len(own)
            if len(own):  # the upper of the middle two; heights are kept to a fiftieth of a millimetre
                assert view.height_mm[row, column] == pytest.approx(own[len(own) // 2], abs=0.011)
            else:
                assert np.isnan(view.height_mm[row, column])


def test_centre_of_a_cell_has_whole_coordinates():
    view = view_from_above(scattered(lambda x, y: 0 * x), np.zeros(40000, np.float32))
    assert view.cells_px(view.centres_mm())[4, 7] == pytest.approx([7, 4], abs=1e-3)
    assert view_from_above(np.empty((0, 3), np.float32), np.empty(0, np.float32)) is None


def test_trend_follows_a_tilted_and_bent_table():
    points = scattered(lambda x, y: 0.01 * x - 0.005 * y + 1e-5 * x * x)
    trend = fit_table_trend(points)
    assert trend.height_mm(points[:, :2]) == pytest.approx(points[:, 2], abs=0.4)  # the prior pulls a little
    points = scattered(lambda x, y: np.where(np.hypot(x, y) < 100, 12.0, 0.0))  # what stands on it does not lift it
    assert np.abs(fit_table_trend(points).height_mm(points[:, :2])).max() < 0.5
    of_nothing = fit_table_trend(np.empty((0, 3), np.float32)).height_mm(np.array([50.0, -70.0]))
    assert -0.5 < of_nothing < 0.0  # just under the sheet


def test_trend_takes_no_low_slope_at_a_foods_foot_for_table():
    def heights(x, y):  # a plain table shows nothing but the halo of what stands on it
        r = np.hypot(x, y)
        return np.where(r < 40, 30.0, np.where(r < 52, 4.0, np.nan))

    points = scattered(heights)
    points = points[np.isfinite(points[:, 2])]
    assert abs(float(fit_table_trend(points).height_mm(np.zeros(2))) - TREND_MM[0]) < 0.3


def test_points_far_from_the_marker_or_ignored_are_not_used():
    points = np.array([[[0, 0, 1], [900, 0, 1], [0, 0, np.nan], [5, 5, 2]]], np.float32)
    ignored = np.array([[False, False, False, True]])
    assert usable_points(points, ignored).tolist() == [[True, False, False, False]]
