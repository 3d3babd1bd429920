"""The default method on a rendered ball whose poses, mask and parallax are known, so that it alone is tested."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from app.vision.geometry.topview import TableTrend
from app.vision.scene.segmentation import Foods, Region
from app.vision.scene.support import Support
from app.vision.solids.shape import measure_shapes
from app.vision.views.disparity import DisparityMap
from app.vision.views.reconstruction import DepthModel, back_project, plane_points
from app.vision.views.rectification import rectify_by_poses
from tests.unit.vision.stereo_scene import BALL, rendered_views, true_depth, true_parallax

TABLE = TableTrend(np.zeros(6), 0.1)
ON_TABLE = Support(0.0, 0.4, "table")
TOLERANCE = 0.05  # of one ball, whose lower third no view shows


@lru_cache
def scene():
    """The rectified pair, the ball's mask, parallax with noise."""
    pair = rectify_by_poses(*rendered_views(BALL))
    with_ball, without = (
        true_depth(pair.rotation, pair.first_centre_mm, pair.focal_px, pair.centre_px, pair.shape, ball)
        for ball in (BALL, None)
    )
    parallax = true_parallax(pair, BALL)
    parallax += np.random.default_rng(0).normal(0, 0.15, pair.shape)
    parallax[~pair.is_seen] = np.nan
    dense = DisparityMap(parallax.astype(np.float32), np.full(pair.shape, 4.5, np.float32))
    return pair, with_ball < without - 1e-6, dense


def measure(region, scale=1.0, dense=None, pose_sd=0.01, depths=(), is_plain=False, pushed_px=0):
    pair, _, known = scene()
    if is_plain:
        pair = replace(pair, second_bgr=np.full_like(pair.second_bgr, 120))
    pair = replace(pair, second_bgr=np.roll(pair.second_bgr, pushed_px, axis=0))
    dense = dense or known
    pair = replace(pair, first_centre_mm=scale * pair.first_centre_mm, baseline_mm=scale * pair.baseline_mm)
    ideal = DepthModel(0.0, pair.focal_px * pair.baseline_mm)
    points = back_project(pair, ideal.depth_mm(pair.disparity_from_parallax(dense.parallax_px)))
    return measure_shapes(Foods([region], TABLE), pair, dense, points, pose_sd=pose_sd, depths=depths)


@lru_cache
def ball_item():
    (item,) = measure(Region(scene()[1], support=ON_TABLE))
    return item


@lru_cache
def twice_as_large_item():
    """By poses that are less sure, which no length depends on."""
    (item,) = measure(Region(scene()[1], support=Support(0.0, 0.8, "table")), 2.0, pose_sd=0.04)
    return item


def test_ball_has_its_volume_within_its_interval():
    volume = ball_item().volume
    assert np.isclose(volume.volume_ml, BALL.volume_ml, rtol=TOLERANCE)
    assert volume.interval_ml[0] < BALL.volume_ml < volume.interval_ml[1]
    assert volume.interval_ml[1] / volume.interval_ml[0] < 1.6


def test_lengths_times_two_give_eight_times_the_volume_and_unsurer_poses_more_doubt():
    assert twice_as_large_item().volume.relative_sd["pair"] > ball_item().volume.relative_sd["pair"]
    # A few lengths stand fast: how far a point is from the support, the prior of how deep a heap is sunk.
    assert np.isclose(twice_as_large_item().volume.volume_ml / ball_item().volume.volume_ml, 8.0, rtol=0.03)


def test_food_without_parallax_is_a_failure():
    nothing = DisparityMap(np.full(scene()[0].shape, np.nan, np.float32), np.full(scene()[0].shape, 4.5, np.float32))
    found = measure(Region(scene()[1], support=ON_TABLE), dense=nothing)
    assert found.code == "food_not_measured"


@pytest.mark.parametrize("pushed_px", [-40, 40])
def test_food_that_is_not_where_its_form_puts_it_in_the_second_view_does_not_show_rest(pushed_px):
    (pushed,) = measure(Region(scene()[1], support=ON_TABLE), pushed_px=pushed_px)
    assert pushed.seen_again < 0.5
    assert ball_item().seen_again > 0.9
    assert ball_item().shows_rest
    assert not pushed.shows_rest


def test_what_colours_alone_show_is_a_food_if_both_views_show_it_standing():
    pair, ball, _ = scene()
    (item,) = measure(Region(ball, support=ON_TABLE, is_by_colour=True))
    assert item.volume.volume_ml == ball_item().volume.volume_ml
    assert measure(Region(ball, support=ON_TABLE, is_by_colour=True), pushed_px=40).code == "no_food_found"
    places = plane_points(pair)
    paper = (np.abs(places[..., 0]) < 59.0) & (np.abs(places[..., 1]) < 48.0) & pair.is_seen
    assert measure(Region(paper, support=ON_TABLE, is_by_colour=True)).code == "no_food_found"


def test_glass_in_which_no_surface_is_seen_has_no_volume():
    (item,) = measure(Region(scene()[1], support=ON_TABLE, is_unread=True))
    assert (item.volume, item.flags) == (None, ("not_measurable",))


def depth_shown(sd_px):
    """The ball's parallax as a depth map with noise of this sd shows it, px."""
    parallax = scene()[2].parallax_px
    noise = np.random.default_rng(1).normal(0, sd_px, parallax.shape)
    reach, sd = (np.full(parallax.shape, each, np.float32) for each in (4.5, sd_px))
    return DisparityMap((parallax + noise).astype(np.float32), reach, sd, error_area_px=1.0)


def test_depth_map_measures_what_the_second_photograph_does_not_show():
    region = Region(scene()[1], support=ON_TABLE)
    (without,), (item,) = (measure(region, is_plain=True, depths=each) for each in ((), [depth_shown(0.5)]))
    assert without.volume is None
    assert np.isclose(item.volume.volume_ml, BALL.volume_ml, rtol=TOLERANCE)
