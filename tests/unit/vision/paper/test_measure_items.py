import numpy as np
import pytest

from app.vision.paper.measure_items import estimate_volume
from tests.unit.vision.clouds import CAMERA_MM, PLACE_MM, box, cylinder, ellipsoid

# What half a turn and 32 slices leave on clouds with 0.3 mm of noise: no view shows the lower third of a ball, and
# between a box's seen corners the outline runs as an ellipse does.
TOLERANCE = 0.08


@pytest.mark.parametrize(
    "cloud",
    [
        ellipsoid(35.0, 35.0, 35.0),
        ellipsoid(45.0, 30.0, 25.0, 0.5),
        box(80.0, 60.0, 35.0, 0.3),
        box(60.0, 60.0, 50.0),
        cylinder(30.0, 50.0),
    ],
    ids=["ball", "ellipsoid aslant", "box", "cube", "cylinder"],
)
def test_solid_seen_from_one_side_has_its_volume(cloud):
    found = estimate_volume(cloud.points_mm, 0.0, None, CAMERA_MM)
    assert abs(found.volume_ml / cloud.volume_ml - 1) < TOLERANCE
    assert found.interval_ml[0] < cloud.volume_ml < found.interval_ml[1]
    assert np.isclose(found.volume_ml, sum(each.volume_ml for each in found.slices))


def test_unsure_poses_widen_the_interval():
    points = ellipsoid(35.0, 35.0, 35.0).points_mm
    sure, unsure = (estimate_volume(points, 0.0, None, CAMERA_MM, pose_sd=sd) for sd in (0.01, 0.04))
    assert unsure.relative_sd["pair"] > sure.relative_sd["pair"]
    assert np.ptp(unsure.interval_ml) > np.ptp(sure.interval_ml)


def test_few_points_give_no_volume():
    assert estimate_volume(np.zeros((30, 3)) + PLACE_MM + np.array([0, 0, 10]), 0.0, None, CAMERA_MM) is None
