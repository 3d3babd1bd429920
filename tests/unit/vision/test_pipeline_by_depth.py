"""A depth map with one photograph: less doubt, and no marker needed; with a pair: never worse than the pair alone."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.fallbacks import MARKER_UNSEEN
from app.vision.model import DepthMap, EstimateOptions, PhotoPair
from app.vision.pipeline import estimate_meal
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, covered, on_plain_table, true_depth

OPTIONS = EstimateOptions(SPEC, CAMERA)
NOISE_SHARE = 0.01  # a phone's sensor
TOLERANCE = 0.12  # half of what one photograph alone may err by


@pytest.fixture(scope="module")
def photo(views):
    view = views[0]
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


def test_depth_and_marker_measure_the_ball_with_less_doubt_than_the_photograph_alone(by_marker, single):
    [item] = by_marker.items
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert item.volume_interval_ml[0] < BALL.volume_ml < item.volume_interval_ml[1]
    assert item.relative_sd["item"] < single.items[0].relative_sd["item"]


@pytest.fixture(scope="module")
def by_map(photo):
    return estimate_meal(PhotoPair(photo), replace(OPTIONS, marker=None), want_artefacts=True)


@pytest.mark.slow
def test_depth_without_a_marker_gives_the_scale(by_map, by_marker):
    assert by_map.failure is None
    measured = [item for item in by_map.items if item.volume_ml is not None]  # the board is an item, too
    item = min(measured, key=lambda each: abs(each.volume_ml / BALL.volume_ml - 1))
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert "scale_from_depth" in item.flags
    assert "scale_from_depth" not in by_marker.items[0].flags


@pytest.fixture(scope="module")
def pair_with_map(photo, pair):
    return replace(pair, left=replace(pair.left, depth=photo.depth))


def scaled(pair, factor):
    depth = pair.left.depth
    return replace(pair, left=replace(pair.left, depth=replace(depth, depth_mm=depth.depth_mm * np.float32(factor))))


@pytest.mark.slow
def test_pair_with_a_depth_map_is_no_worse_than_the_pair_and_takes_its_scale(pair_with_map, estimate):
    both, off_scale = (estimate_meal(each, OPTIONS) for each in (pair_with_map, scaled(pair_with_map, 1.05)))
    errors = [abs(each.items[0].volume_ml / BALL.volume_ml - 1) for each in (both, estimate)]
    assert errors[0] < max(errors[1], 0.03)  # of a ball whose lower third no view shows
    assert both.items[0].relative_sd["item"] <= estimate.items[0].relative_sd["item"] * 1.05
    assert off_scale.items[0].volume_ml == pytest.approx(both.items[0].volume_ml, rel=0.005)
    assert "depth_ignored" not in off_scale.items[0].flags


@pytest.mark.slow
def test_map_that_contradicts_the_marker_is_left_out_with_a_flag(pair_with_map, estimate):
    without_map = estimate_meal(scaled(pair_with_map, 1.3), OPTIONS)
    assert without_map.items[0].volume_ml == estimate.items[0].volume_ml
    assert without_map.items[0].flags == (*estimate.items[0].flags, "depth_ignored")


def as_of_two_cameras(photo, scale=0.62, offset=-0.4e-3):
    """The photograph with its map as an iPhone's pair of cameras gives it: scale and offset unknown."""
    depth_mm = (1.0 / (scale / photo.depth.depth_mm + offset)).astype(np.float32)
    return replace(photo, depth=replace(photo.depth, depth_mm=depth_mm, is_aligned=True, is_relative=True))


@pytest.mark.slow
def test_relative_map_takes_scale_and_offset_from_the_markers_table(photo, by_marker):
    [item] = estimate_meal(PhotoPair(as_of_two_cameras(photo)), OPTIONS).items
    assert item.volume_ml == pytest.approx(by_marker.items[0].volume_ml, rel=0.03)  # of the same noise
    assert item.flags == by_marker.items[0].flags
    [other] = estimate_meal(PhotoPair(as_of_two_cameras(photo, 2.0, 1e-3)), OPTIONS).items
    assert other.volume_ml == pytest.approx(item.volume_ml, rel=0.03)


def test_maps_that_give_no_scale_say_so(photo, views):
    noise = np.random.default_rng(1).uniform(200.0, 2000.0, photo.depth.depth_mm.shape).astype(np.float32)
    of_chance, no_marker = replace(photo, depth=replace(photo.depth, depth_mm=noise)), replace(OPTIONS, marker=None)
    assert estimate_meal(PhotoPair(of_chance), no_marker).failure.code == "table_not_found"
    assert estimate_meal(PhotoPair(as_of_two_cameras(photo)), no_marker).failure.code == "scale_missing"
    for shown in (as_of_two_cameras(photo), replace(photo, depth=None)):
        hidden = covered(replace(views[0], photo=shown)).photo
        assert estimate_meal(PhotoPair(hidden), OPTIONS).failure.code in MARKER_UNSEEN
