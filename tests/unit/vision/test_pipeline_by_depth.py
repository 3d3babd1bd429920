"""One photograph with a depth map: the ball's volume with less doubt, and without any marker at all."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.model import DepthMap, EstimateOptions, PhotoPair
from app.vision.pipeline import estimate_meal
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, rendered_views, true_depth
from tests.unit.vision.test_pipeline_of_one import on_plain_table

BALL = Ball((115.0, 15.0), 33.0)
OPTIONS = EstimateOptions(SPEC, CAMERA)
NOISE_SHARE = 0.01  # a phone's sensor
TOLERANCE = 0.12  # half of what one photograph alone may err by


@pytest.fixture(scope="module")
def photo():
    view = rendered_views(BALL)[0]
    shrink = CAMERA.width / 256
    shape = (round(CAMERA.height / shrink), 256)
    focal, centre = CAMERA.fx / shrink, ((CAMERA.cx + 0.5) / shrink - 0.5, (CAMERA.cy + 0.5) / shrink - 0.5)
    depth = true_depth(view.rotation, view.centre_mm, focal, centre, shape, BALL)
    depth = depth * (1 + NOISE_SHARE * np.random.default_rng(0).standard_normal(shape))
    measured = DepthMap(depth.astype(np.float32), focal, focal, *centre, sd_share=NOISE_SHARE, error_area_px=1.0)
    return replace(on_plain_table(view.photo), depth=measured)


@pytest.fixture(scope="module")
def by_marker(photo):
    return estimate_meal(PhotoPair(photo), OPTIONS)


def test_depth_and_marker_measure_the_ball_with_less_doubt_than_the_photograph_alone(photo, by_marker):
    [item] = by_marker.items
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert item.volume_interval_ml[0] < BALL.volume_ml < item.volume_interval_ml[1]
    [alone] = estimate_meal(PhotoPair(replace(photo, depth=None)), OPTIONS).items
    assert item.relative_sd["item"] < alone.relative_sd["item"]


def volumes_ml(estimate):
    return [item.volume_ml for item in estimate.items if item.volume_ml is not None]


def test_depth_without_a_marker_gives_the_scale(photo, by_marker):
    estimate = estimate_meal(PhotoPair(photo), replace(OPTIONS, marker=None), want_artefacts=True)
    assert estimate.failure is None
    measured = [item for item in estimate.items if item.volume_ml is not None]  # the board is an item, too
    item = min(measured, key=lambda each: abs(each.volume_ml / BALL.volume_ml - 1))
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert "scale_from_depth" in item.flags
    assert "scale_from_depth" not in by_marker.items[0].flags


def test_depth_twice_as_far_without_a_marker_makes_eight_times_the_volume(photo):
    options = replace(OPTIONS, marker=None)
    far = replace(photo, depth=replace(photo.depth, depth_mm=photo.depth.depth_mm * 2))
    near_ml, far_ml = (
        min(volumes_ml(estimate_meal(PhotoPair(each), options)), key=lambda ml: abs(ml - near))
        for each, near in ((photo, BALL.volume_ml), (far, 8 * BALL.volume_ml))
    )
    assert far_ml / near_ml == pytest.approx(8.0, rel=0.2)  # priors in mm, of supports and heights, do not scale


def test_depth_map_of_chance_has_no_table(photo):
    noise = np.random.default_rng(1).uniform(200.0, 2000.0, photo.depth.depth_mm.shape).astype(np.float32)
    chaos = replace(photo, depth=replace(photo.depth, depth_mm=noise))
    assert estimate_meal(PhotoPair(chaos), replace(OPTIONS, marker=None)).failure.code == "table_not_found"
