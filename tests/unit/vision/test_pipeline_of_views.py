"""More than two photographs of one scene: the best partner is chosen; others join in any order, or add nothing."""

from dataclasses import astuple

import numpy as np
import pytest

from app.vision import placement
from app.vision.model import EstimateOptions, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.stereo import stillness
from app.vision.stereo.features import Matches, match_features
from app.vision.stereo.other_views import stereo_partners
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, look_at, render

OPTIONS = EstimateOptions(SPEC, CAMERA)
FAR_MM, OTHER_MM = (260.0, -200.0, 330.0), (-120.0, -200.0, 330.0)


def photographed(centre_mm, ball=BALL, cloth=0):
    pixels = render(look_at(centre_mm, (60.0, 0.0, 10.0)), ball, cloth)
    noisy = pixels + np.random.default_rng(2).normal(0.0, 1.0, pixels.shape)
    return Photo(np.clip(noisy + 0.5, 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def photographs(pair):
    """At 0, 8, 33 and 21 degrees from the first."""
    return [pair.left, pair.right, photographed(FAR_MM), photographed(OTHER_MM)]


def measured(photos, **options):
    left, right, *others = photos
    return estimate_meal(PhotoPair(left, right, tuple(others)), OPTIONS, **options)


@pytest.fixture(scope="module")
def four(photographs):
    return measured(photographs)


@pytest.mark.slow
def test_four_photographs_measure_the_ball_with_less_doubt(estimate, four):
    assert four.parameters["views"] == 4
    item, of_pair = four.items[0], estimate.items[0]
    assert item.volume_interval_ml[0] < BALL.volume_ml < item.volume_interval_ml[1]
    assert abs(item.volume_ml / BALL.volume_ml - 1) < abs(of_pair.volume_ml / BALL.volume_ml - 1) + 0.01
    assert item.relative_sd["item"] < of_pair.relative_sd["item"]


def test_nearest_partner_is_tried_first_wherever_it_stands_and_the_farthest_last(photographs):
    left, near, far, other = photographs
    tried = stereo_partners(PhotoPair(left, far, (other, near)), SPEC)
    expected = [(near, (far, other)), (other, (far, near)), (far, (other, near))]
    assert tried == [PhotoPair(left, right, others) for right, others in expected]


@pytest.mark.slow
def test_another_partner_is_tried_where_the_nearest_shows_another_scene(photographs):
    left, _, _, other = photographs
    moved = photographed((90.0, -260.0, 330.0), None, cloth=7)
    third = measured([left, moved, other])
    assert (third.failure, third.second_place) == (None, 2)
    assert third.items[0].volume_ml == measured([left, other]).items[0].volume_ml


@pytest.mark.slow
def test_partner_that_shares_no_points_comes_after_all_that_do(photographs, monkeypatch):
    left, near, far, _ = photographs

    def only_the_marker_in_near(first, second, **gate):
        matches = match_features(first, second, **gate)
        is_kept = matches.is_board | (not np.array_equal(near.pixels_bgr, second.photo.pixels_bgr))
        return Matches(*(values[is_kept] for values in astuple(matches)))

    for module in (placement, stillness):
        monkeypatch.setattr(module, "match_features", only_the_marker_in_near)
    assert measured([left, near]).items[0].flags[-1] == "few_matches"
    both = measured([left, near, far])
    assert (both.failure, both.second_place) == (None, 2)
    assert "few_matches" not in both.items[0].flags


@pytest.mark.slow
def test_partner_that_is_not_the_right_photograph_is_named(photographs, scene_of):
    left, near, far, _ = photographs
    third = measured([left, far, near], want_artefacts=True)
    assert (third.second_place, third.parameters["second_view"]) == (2, 3)
    scene = scene_of(third)
    assert list(scene["photographs"]) == ["left"]  # the right photograph's corners were not looked for
    assert not any("right_rings_px" in item for item in scene["items"])


@pytest.mark.slow
def test_partner_that_fails_leaves_the_pair_as_it_was_sent(photographs):
    cropped = Photo(np.ascontiguousarray(photographs[1].pixels_bgr[:, 40:]))  # no camera of this size
    third = measured([photographs[0], photographs[2], cropped])
    assert third.failure is None
    assert third.second_place == 1
    assert third.items[0].volume_ml == measured([photographs[0], photographs[2]]).items[0].volume_ml


@pytest.mark.slow
def test_order_of_the_others_does_not_change_the_volume(photographs, four):
    left, near, far, other = photographs
    again = measured([left, other, near, far])
    assert again.items[0].volume_ml == pytest.approx(four.items[0].volume_ml, rel=1e-6)


@pytest.mark.slow
def test_photographs_without_a_marker_and_of_another_scene_add_nothing(photographs, estimate):
    blank = Photo(np.full_like(photographs[0].pixels_bgr, 128))
    more = measured([*photographs[:2], blank, photographed(OTHER_MM, None, cloth=7)])
    assert "views" not in more.parameters
    assert more.items[0].volume_ml == estimate.items[0].volume_ml


@pytest.mark.slow
def test_photograph_from_farther_along_the_same_line_of_sight_joins(photographs, estimate):
    """It could be no stereo partner of the first, and shows the outline all the same."""
    third = measured([*photographs[:2], photographed((39.0, -338.0, 429.0))])
    assert third.parameters["views"] == 3
    assert third.items[0].volume_ml == pytest.approx(estimate.items[0].volume_ml, rel=0.05)
