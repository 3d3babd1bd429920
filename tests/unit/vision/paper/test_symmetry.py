import numpy as np
import pytest

from app.vision.paper.symmetry import complete, fit_axis
from tests.unit.vision.clouds import PLACE_MM, box, ellipsoid

THICKNESS_MM = 2.0


def axis_of(cloud, form=None):
    return fit_axis(cloud.points_mm, THICKNESS_MM, form, cloud.towards_camera)


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5])
def test_axis_of_an_ellipsoid_seen_from_one_side_is_its_own(heading):
    axis = axis_of(ellipsoid(45.0, 30.0, 25.0, heading))
    assert np.hypot(*(axis.centre_mm - PLACE_MM[:2])) < 2.0
    assert abs(axis.aspect - 1.5) < 0.08
    assert abs(np.sin(axis.heading - heading)) < 0.08


def test_ball_and_a_known_form_give_a_circle():
    axis = axis_of(ellipsoid(35.0, 35.0, 35.0))
    assert axis.aspect == axis_of(ellipsoid(45.0, 30.0, 25.0), "circle").aspect == 1.0
    assert np.hypot(*(axis.centre_mm - PLACE_MM[:2])) < 1.5
    with pytest.raises(ValueError, match="8 points"):
        fit_axis(np.zeros((7, 3)), 1.0, None, np.array([1.0, 0.0]))


def test_completion_of_a_box_fills_its_far_corner():
    cloud = box(60.0, 40.0, 30.0, 0.4)
    axis = axis_of(cloud)
    completed = complete(cloud.points_mm, THICKNESS_MM, axis)
    assert np.array_equal(completed[: len(cloud.points_mm)], cloud.points_mm)
    assert len(completed) > len(cloud.points_mm)
    low = cloud.points_mm[cloud.points_mm[:, 2] < 20.0]
    far = -(low[:, :2] - PLACE_MM[:2]) @ cloud.towards_camera
    low_completed = completed[completed[:, 2] < 20.0]
    far_completed = -(low_completed[:, :2] - PLACE_MM[:2]) @ cloud.towards_camera
    assert far.max() < 25.0
    assert far_completed.max() > 0.9 * (30.0 * np.sin(0.4) + 20.0 * np.cos(0.4))
