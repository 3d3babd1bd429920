import numpy as np
import pytest

from app.vision.geometry.symmetry import complete, fit_axis, main_body, outline, slice_index
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


def test_hollow_on_the_far_side_is_no_outline():
    angle = np.random.default_rng(0).uniform(0, 2 * np.pi, 4000)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(4000)])
    lip, hollow = ring * 20.0 + np.array([0, 0, 63.0]), ring * 8.0 + np.array([0, 0, 61.0])
    points = np.concatenate([lip, hollow])
    towards_camera = np.array([0.0, -1.0])
    chosen = points[outline(points, THICKNESS_MM, np.zeros(2), towards_camera)]
    low = chosen[slice_index(chosen[:, 2], THICKNESS_MM) == 30]
    assert len(low) == 24  # the near side could be an overhang
    assert (low[:, 1] < 0).all()


def test_strays_do_not_belong_to_the_body():
    cloud = ellipsoid(35.0, 35.0, 35.0)
    strays = PLACE_MM + np.array([150.0, 0.0, 5.0]) + np.random.default_rng(0).normal(0, 3, (50, 3))
    body = main_body(np.concatenate([cloud.points_mm, strays]))
    assert body[:, 0].max() < PLACE_MM[0] + 40.0
    assert len(body) > 0.95 * len(cloud.points_mm)
