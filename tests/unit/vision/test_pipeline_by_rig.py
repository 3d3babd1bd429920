"""The whole way by a stereo rig on a rendered ball: no marker is looked for, the volume is right all the same."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.model import EstimateOptions, PhotoPair
from app.vision.pipeline import estimate_meal
from tests.unit.vision.rigs import rig_of
from tests.unit.vision.stereo_scene import BALL

TOLERANCE = 0.06  # the target of rendered meals by a rig of 60 mm


@pytest.fixture(scope="module")
def by_rig(views, pair):
    return estimate_meal(pair, EstimateOptions(None, rig=rig_of(*views)), want_artefacts=True)


def test_ball_has_its_volume_without_a_marker_and_colours_stay_as_taken(by_rig):
    assert by_rig.failure is None
    ball = max(by_rig.items, key=lambda item: item.volume_ml)
    assert abs(ball.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert ball.volume_interval_ml[0] < BALL.volume_ml < ball.volume_interval_ml[1]
    assert [colour.kind for colour in by_rig.colours] == ["none", "none"]
    assert all("colour_uncorrected" in colour.flags for colour in by_rig.colours)
    assert "marker_thick_mm" not in by_rig.parameters
    assert {"overlay.jpg", "points.ply", "rectified.jpg"} <= {artefact.name for artefact in by_rig.artefacts}


@pytest.mark.slow
def test_cameras_in_the_other_order_give_the_same_volume(views, by_rig):
    left, right = views
    swapped = estimate_meal(PhotoPair(right.photo, left.photo), EstimateOptions(None, rig=rig_of(right, left)))
    volumes = [max(item.volume_ml for item in each.items) for each in (by_rig, swapped)]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.03)  # the table is found from the other photograph


@pytest.mark.slow
def test_calibration_of_another_rig_is_refused(views):
    left, right = views
    turn = cv2.Rodrigues(np.radians([2.0, 0.0, 0.0]))[0]
    other = replace(right, rotation=turn @ right.rotation, translation_mm=turn @ right.translation_mm)
    refused = estimate_meal(PhotoPair(left.photo, right.photo), EstimateOptions(None, rig=rig_of(left, other)))
    assert refused.failure.code in ("rig_mismatch", "table_not_found")
    assert refused.items == ()
