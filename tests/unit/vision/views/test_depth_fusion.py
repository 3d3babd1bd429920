"""Depth of a ball on the pair's grid, by maps and further matches: known truth, the marker's scale, fusion."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.model import DepthMap
from app.vision.views.depth_fusion import MAX_SCALE_ERROR, agree_with_table, fuse_depths
from app.vision.views.depth_parallax import parallax_of_depth, parallax_of_match
from app.vision.views.disparity import DisparityMap
from app.vision.views.other_views import second_pair
from app.vision.views.rectification import rectify_by_poses
from tests.unit.vision.stereo_scene import CAMERA, Ball, blank_views, look_at, true_depth, true_parallax, view_of

BALL = Ball((60.0, 10.0), 33.0)
MAP = (300, 400)  # the photographs' height and width divided by three
FOCAL, CENTRE = CAMERA.fx / 3, ((CAMERA.cx + 0.5) / 3 - 0.5, (CAMERA.cy + 0.5) / 3 - 0.5)


def depth_map(view, ball=BALL, sd_share=0.001):
    depth = true_depth(view.rotation, view.centre_mm, FOCAL, CENTRE, MAP, ball)
    return DepthMap(depth.astype(np.float32), FOCAL, FOCAL, *CENTRE, sd_share=sd_share, error_area_px=2.0)


@pytest.fixture(scope="module")
def scene():
    views = blank_views(roll_deg=8.0)
    pair = rectify_by_poses(*views)

    return views, pair, true_parallax(pair, BALL), true_parallax(pair, None)


@pytest.mark.parametrize("which", [0, 1], ids=["first", "second"])
def test_map_of_either_view_is_the_true_parallax_of_the_first(scene, which):
    views, pair, truth, _ = scene
    shown = parallax_of_depth(pair, views[which], depth_map(views[which]))
    seen = np.isfinite(shown.parallax_px) & pair.is_seen
    assert np.mean(seen[pair.is_seen]) > 0.85  # the second view's map ends where its photograph does
    off = np.abs(shown.parallax_px - truth)[seen]
    # Moved along the row it is half a pixel off its place, on a slope of a few tenths; the ball's edge is interpolated.
    assert np.quantile(off, 0.95) < (0.1 if which == 0 else 0.5)
    assert abs(np.median((shown.parallax_px - truth)[seen])) < 0.05
    on_ball = seen & (truth > 20.0)
    assert np.median(np.abs(shown.parallax_px - truth)[on_ball]) < 0.2
    if which == 0:
        noisy = parallax_of_depth(pair, views[0], depth_map(views[0], sd_share=0.02))
        assert np.isclose(np.nanmedian(noisy.sd_px / pair.disparity_from_parallax(truth)), 0.02, rtol=0.05)
        assert np.isclose(noisy.error_area_px, 2.0 * (pair.focal_px / FOCAL) ** 2)


def agreed(scene, change, *, has_tilt=True):
    views, pair, truth, table = scene
    depth = depth_map(views[0])
    shown = parallax_of_depth(pair, views[0], replace(depth, depth_mm=change(depth.depth_mm).astype(np.float32)))
    return agree_with_table(pair, shown, truth, np.abs(truth - table) < 0.01, has_tilt=has_tilt)


@pytest.mark.parametrize(("factor", "has_tilt"), [(1.0, False), (0.95, True), (1.05, False)])
def test_map_that_errs_in_scale_takes_the_scale_of_the_table(scene, factor, has_tilt):
    _, pair, truth, _ = scene
    off = np.abs(agreed(scene, lambda depth: depth * factor, has_tilt=has_tilt).parallax_px - truth)[pair.is_seen]
    assert np.nanquantile(off, 0.9) < 0.2


OTHER_TABLES = {
    "another unit": lambda depth: depth * (1 + 1.5 * MAX_SCALE_ERROR),
    "a wall": lambda depth: np.full_like(depth, np.median(depth)),
    "upside down": lambda depth: depth[::-1],
    "empty": lambda depth: np.full_like(depth, np.nan),
    "chance": lambda depth: np.random.default_rng(0).uniform(200, 800, depth.shape),
}


@pytest.mark.parametrize("change", OTHER_TABLES.values(), ids=OTHER_TABLES)
def test_map_of_another_table_is_refused(scene, change):
    assert agreed(scene, change) is None


def fused(pair, match, *maps, is_averaged=False):
    shape = pair.shape

    def filled(value, sd, reach):
        return DisparityMap(*(np.full(shape, each, np.float32) for each in (value, reach, sd)), error_area_px=9.0)

    return fuse_depths(pair, filled(*match), [filled(*each) for each in maps], 0.5, is_averaged=is_averaged)


def middle(pair, of):
    row, column = (side // 2 for side in pair.shape)
    return [float(each[row, column]) for each in (of.parallax_px, of.sd_px, of.reach_px)]


def test_fusion_weighs_by_precision_and_tells_the_sd_that_it_leaves(scene):
    _, pair, *_ = scene
    value, sd, reach = middle(pair, fused(pair, (10.0, 0.5, 4.5), (11.0, 1.0, 3.0)))
    assert np.isclose(value, 10.2)
    assert np.isclose(sd, 1 / np.hypot(1 / 0.5, 1 / 1.0))
    assert reach == 4.5
    assert middle(pair, fused(pair, (10.0, 0.5, 4.5))) == [10.0, 0.5, 4.5]
    # A match counts no more than dense matches may, and of two that disagree the surer one counts.
    assert np.isclose(middle(pair, fused(pair, (10.0, 0.01, 4.5), (11.0, 0.5, 3.0)))[0], 10.5)
    assert middle(pair, fused(pair, (10.0, 0.5, 4.5), (30.0, 0.1, 3.0)))[0] == 30.0
    assert middle(pair, fused(pair, (10.0, 0.5, 4.5), (30.0, 3.0, 3.0)))[0] == 10.0


def test_gap_is_filled_by_a_sure_map_or_match_alone(scene):
    _, pair, *_ = scene
    gap = (np.nan, np.nan, 0.0)
    assert middle(pair, fused(pair, gap, (11.0, 0.2, 3.0)))[::2] == [11.0, 3.0]
    assert middle(pair, fused(pair, gap, (11.0, 0.2, 3.0), is_averaged=True))[::2] == [11.0, 3.0]
    assert np.isnan(middle(pair, fused(pair, gap, (11.0, 5.0, 3.0), is_averaged=True))[0])


@pytest.mark.parametrize("place_mm", [(150.0, -230.0, 330.0), (60.0, -330.0, 240.0)])
def test_match_with_a_further_view_is_the_true_parallax_of_the_pair(scene, place_mm):
    (first, _), pair, truth, _ = scene
    further = view_of(first.photo.pixels_bgr, look_at(place_mm, (60.0, 0.0, 10.0)))
    own = rectify_by_poses(first, further)
    reach, sd = (np.full(own.shape, each, np.float32) for each in (4.5, 0.1))
    match = DisparityMap(true_parallax(own, BALL), reach, sd)
    shown = parallax_of_match(pair, own, match, 0.5)
    seen = np.isfinite(shown.parallax_px) & pair.is_seen
    assert np.mean(seen[pair.is_seen]) > 0.6
    assert np.quantile(np.abs(shown.parallax_px - truth)[seen], 0.95) < 0.2
    # A tenth of a pixel at twice the baseline is half of that here; of the match no less than 0.5 px is believed.
    at_same_depth = pair.focal_px * pair.baseline_mm / (own.focal_px * own.baseline_mm)
    assert np.isclose(np.nanmedian(shown.sd_px), 0.5 * at_same_depth, rtol=0.3)


def test_match_of_two_other_views_is_the_true_parallax_where_the_first_sees_it(scene):
    (first, _), pair, truth, _ = scene
    others = [view_of(first.photo.pixels_bgr, look_at((x, -190.0, 350.0), (60.0, 0.0, 10.0))) for x in (150.0, 190.0)]
    own = rectify_by_poses(*others)
    nothing = np.full(own.shape, np.nan, np.float32)
    reach, sd = (np.full(own.shape, each, np.float32) for each in (4.5, 0.1))
    match = DisparityMap(np.where(own.is_seen, true_parallax(own, BALL), nothing), reach, sd)
    shown = parallax_of_match(pair, own, match, 0.5)
    seen = np.isfinite(shown.parallax_px) & pair.is_seen
    assert np.mean(seen[pair.is_seen]) > 0.6
    off = np.abs(shown.parallax_px - truth)[seen]
    # A point is half a pixel off its place, on a slope of some tenths; the table behind the ball shows at its edge.
    assert np.quantile(off, 0.9) < 0.5
    assert np.median(np.abs(shown.parallax_px - truth)[seen & (truth > 20.0)]) < 0.3
    # Half a pixel at two thirds of the baseline; the two stand about as far away.
    at_same_depth = pair.focal_px * pair.baseline_mm / (own.focal_px * own.baseline_mm)
    assert np.isclose(np.nanmedian(shown.sd_px), 0.5 * at_same_depth, rtol=0.3)


def view_from(*place_mm):
    return view_of(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), look_at(place_mm, (60.0, 0.0, 10.0)))


def test_second_pair_is_the_first_with_the_nearest_view_that_stands_beside_it():
    first, second = blank_views()
    near, far = view_from(100.0, -250.0, 330.0), view_from(200.0, -200.0, 330.0)
    behind, opposite = view_from(28.0, -295.0, 372.0), view_from(60.0, 260.0, 330.0)
    assert second_pair(first, second, [far, behind, near, opposite]) == (first, near)
    assert second_pair(first, second, [behind]) is None
    assert second_pair(first, second, []) is None
    # Two views less than half as far apart as any from the first are matched with each other.
    first, second = view_from(-120.0, -200.0, 330.0), view_from(120.0, -250.0, 330.0)
    close, less_close = view_from(160.0, -240.0, 330.0), view_from(260.0, -200.0, 330.0)
    assert second_pair(first, second, [less_close, close]) == (second, close)
    nearer = view_from(-20.0, -240.0, 330.0)
    assert second_pair(first, second, [less_close, nearer]) == (first, nearer)
