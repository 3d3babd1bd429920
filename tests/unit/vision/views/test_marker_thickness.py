"""A print on a plaque: poses in the table frame, what of a photograph it hides, and its thickness where unannounced."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.board.pose import bent_points, board_points, solve_pose
from app.vision.marker_spec import parse_marker
from app.vision.model import MarkerObservation
from app.vision.views.features import shows_sheet
from app.vision.views.marker_thickness import find_thickness, on_plaque
from app.vision.views.relative_pose import RefinedViews
from tests.unit.vision.stereo_scene import CAMERA, SPEC, blank_views

PLAQUE = replace(SPEC, thick_mm=8.0)
PRINT_OVER_CARRIER_MM = 0.3  # topview.TREND_MM: paper lies that much over what carries it


def measured_table(table_mm, *, slopes=(0.0, 0.0), noise_mm=0.8, dish_mm=None, seed=0):
    """(n, 3) points of a table beside the print, mm, z from the print; dish_mm: height of a dish's floor on it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-200.0, 200.0, (40000, 2))
    xy = xy[(np.abs(xy[:, 0]) > 61.0) | (np.abs(xy[:, 1]) > 50.0)]
    z = table_mm + xy @ np.array(slopes) / 200.0
    if dish_mm is not None:
        z = np.where(np.hypot(xy[:, 0] - 150.0, xy[:, 1]) < 80.0, table_mm + dish_mm, z)
    return np.column_stack([xy, z + rng.normal(0.0, noise_mm, len(z))]).astype(np.float32)


def test_pose_of_a_plaque_is_that_of_its_table():
    assert (board_points(PLAQUE)[:, 2] == 8.0).all()
    assert bent_points(PLAQUE, np.zeros(3)) == pytest.approx(board_points(PLAQUE))
    assert board_points(PLAQUE)[:, :2] == pytest.approx(board_points(SPEC)[:, :2])
    view = on_plaque(RefinedViews(*blank_views(), np.zeros(3), 0), 8.0).first
    solved = solve_pose(CAMERA, view.marker)
    assert solved is not None
    assert solved[0] == pytest.approx(view.rotation, abs=1e-6)
    assert solved[1] == pytest.approx(view.translation_mm, abs=1e-3)


@pytest.mark.parametrize("thick_mm", [0.0, 8.0])
def test_lines_of_sight_to_print_and_sides_are_the_plaques(thick_mm):
    spec, centre = replace(SPEC, thick_mm=thick_mm), np.array([0.0, -300.0, 300.0])
    x, y = np.meshgrid(np.linspace(-150.0, 150.0, 61), np.linspace(-150.0, 150.0, 61))
    plane = np.stack([x, y, np.zeros_like(x)], -1).astype(np.float32)
    half = (np.array([spec.columns, spec.rows]) / 2 + 1.0) * spec.square_mm
    # The slow way: points along each line of sight between the print's height and the table.
    shares = np.linspace(0.0, thick_mm / centre[2], 200)[:, None, None, None]
    along = plane[..., :2] + shares * (centre[:2] - plane[..., :2])
    is_hit = (np.abs(along) <= half).all(axis=-1).any(axis=0)
    assert np.array_equal(shows_sheet(MarkerObservation(spec, np.empty((0, 2))), plane, centre), is_hit)


@pytest.mark.parametrize("thick_mm", [2.5, 8.0, 11.5])
def test_thickness_is_found_under_a_slope_that_poses_leave(thick_mm):
    points = measured_table(-thick_mm - PRINT_OVER_CARRIER_MM, slopes=(1.5, -1.0))
    # Cells of 8 mm are good to 0.2 mm each; the slope's prior draws it by some tenths.
    assert find_thickness(SPEC, points) == pytest.approx(thick_mm, abs=0.4)
    on_dish = measured_table(-thick_mm - PRINT_OVER_CARRIER_MM, dish_mm=5.0)  # whose floor is not the table
    assert find_thickness(SPEC, on_dish) == pytest.approx(thick_mm, abs=0.4)


@pytest.mark.parametrize("table_mm", [0.5, -1.2])
def test_sheet_of_paper_stays_a_sheet(table_mm):
    assert find_thickness(SPEC, measured_table(table_mm, slopes=(1.5, 1.5))) == 0.0
    assert find_thickness(SPEC, measured_table(table_mm, dish_mm=6.0)) == 0.0
    assert find_thickness(SPEC, measured_table(-20.0)) == 0.0  # far under the print: no plaque
    assert find_thickness(SPEC, measured_table(-8.3)[:300]) == 0.0  # too few points
    assert str(parse_marker("plain:9x7:11:thick=0")) == "plain:9x7:11"
