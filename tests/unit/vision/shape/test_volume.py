import numpy as np
import pytest

from app.vision.shape.volume import estimate_volume
from tests.unit.vision.clouds import CAMERA_MM, PLACE_MM, box, cylinder, ellipsoid

# What half a turn and 32 slices leave on clouds with 0.3 mm of noise: no view shows the lower third of a ball, and
# between a box's seen corners the outline runs as an ellipse does.
TOLERANCE = 0.08


@pytest.mark.parametrize(
    "cloud",
    [
        ellipsoid(35.0, 35.0, 35.0),
        ellipsoid(45.0, 30.0, 25.0, 0.5),
        ellipsoid(45.0, 30.0, 25.0, np.pi / 2),
        box(80.0, 60.0, 35.0, 0.3),
        box(60.0, 60.0, 50.0),
        cylinder(30.0, 50.0),
        cylinder(50.0, 20.0),
    ],
    ids=["ball", "ellipsoid aslant", "ellipsoid end on", "box", "cube", "tall cylinder", "flat cylinder"],
)
def test_solid_seen_from_one_side_has_its_volume(cloud):
    found = estimate_volume(cloud.points_mm, 0.0, None, CAMERA_MM)
    assert abs(found.volume_ml / cloud.volume_ml - 1) < TOLERANCE
    assert found.interval_ml[0] < cloud.volume_ml < found.interval_ml[1]
    assert np.isclose(found.volume_ml, sum(each.volume_ml for each in found.slices))


def test_volume_grows_with_the_cube_of_lengths_whichever_form_is_known():
    cloud = ellipsoid(45.0, 30.0, 25.0)
    for form, fitted in (("circle", "circle"), (None, "ellipse")):
        one = estimate_volume(cloud.points_mm, 0.0, form, CAMERA_MM)
        two = estimate_volume(2 * cloud.points_mm, 0.0, form, 2 * CAMERA_MM)
        assert (one.form, two.form) == (fitted, fitted)
        assert np.isclose(two.volume_ml / one.volume_ml, 8.0, rtol=0.01)


def test_raised_support_does_not_make_the_food_taller():
    cloud = cylinder(40.0, 30.0)
    low = estimate_volume(cloud.points_mm, 0.0, None, CAMERA_MM)
    up = np.array([0.0, 0.0, 12.0])
    high = estimate_volume(cloud.points_mm + up, 12.0, None, CAMERA_MM + up)
    assert np.isclose(high.volume_ml, low.volume_ml, rtol=0.01)


def test_unsure_poses_widen_the_interval():
    points = ellipsoid(35.0, 35.0, 35.0).points_mm
    sure, unsure = (estimate_volume(points, 0.0, None, CAMERA_MM, pose_sd=sd) for sd in (0.01, 0.04))
    assert unsure.relative_sd["pair"] > sure.relative_sd["pair"]
    assert np.ptp(unsure.interval_ml) > np.ptp(sure.interval_ml)


def test_few_points_give_no_volume():
    assert estimate_volume(np.zeros((30, 3)) + PLACE_MM + np.array([0, 0, 10]), 0.0, None, CAMERA_MM) is None
