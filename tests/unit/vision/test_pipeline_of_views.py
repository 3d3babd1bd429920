"""More than two photographs of one scene: the best partner is chosen; others join in any order, or add nothing."""

import json
from dataclasses import astuple

import numpy as np
import pytest

from app.vision import placement
from app.vision.model import EstimateOptions, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.stereo import stillness
from app.vision.stereo.features import Matches, match_features
from app.vision.stereo.other_views import stereo_partners
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, look_at, render

BALL = Ball((115.0, 15.0), 33.0)
OPTIONS = EstimateOptions(SPEC, CAMERA)
CENTRES_MM = ((30.0, -260.0, 330.0), (90.0, -260.0, 330.0), (260.0, -200.0, 330.0), (-120.0, -200.0, 330.0))


@pytest.fixture(scope="module")
def photographs():
    """At 0, 8, 33 and 21 degrees from the first."""
    out = []
    for seed, centre_mm in enumerate(CENTRES_MM):
        pixels = render(look_at(centre_mm, (60.0, 0.0, 10.0)), BALL, 0)
        noisy = pixels + np.random.default_rng(seed).normal(0.0, 1.0, pixels.shape)
        out.append(Photo(np.clip(noisy + 0.5, 0, 255).astype(np.uint8)))
    return out


def measured(photos):
    left, right, *others = photos
    return estimate_meal(PhotoPair(left, right, tuple(others)), OPTIONS)


@pytest.fixture(scope="module")
def pair(photographs):
    return measured(photographs[:2])


@pytest.fixture(scope="module")
def four(photographs):
    return measured(photographs)


def test_four_photographs_measure_the_ball_with_less_doubt(pair, four):
    assert four.parameters["views"] == 4
    item = four.items[0]
    assert item.volume_interval_ml[0] < BALL.volume_ml < item.volume_interval_ml[1]
    assert abs(item.volume_ml / BALL.volume_ml - 1) < abs(pair.items[0].volume_ml / BALL.volume_ml - 1) + 0.01
    assert item.relative_sd["item"] < pair.items[0].relative_sd["item"]


def test_nearest_partner_is_tried_first_wherever_it_stands_and_the_farthest_last(photographs):
    left, near, far, other = photographs
    tried = stereo_partners(PhotoPair(left, far, (other, near)), SPEC)
    expected = [(near, (far, other)), (other, (far, near)), (far, (other, near))]
    assert tried == [PhotoPair(left, right, others) for right, others in expected]


def test_another_partner_is_tried_where_the_nearest_shows_another_scene(photographs):
    left, _, _, other = photographs
    moved = render(look_at(CENTRES_MM[1], (60.0, 0.0, 10.0)), None, 7)  # another cloth, no ball
    third = measured([left, Photo(np.clip(moved, 0, 255).astype(np.uint8)), other])
    assert (third.failure, third.second_place) == (None, 2)
    assert third.items[0].volume_ml == measured([left, other]).items[0].volume_ml


def test_partner_that_shares_no_points_comes_after_all_that_do(photographs, monkeypatch):
    left, near, far, _ = photographs

    def only_the_marker_in_near(first, second, **gate):
        matches = match_features(first, second, **gate)
        is_kept = matches.is_board | (not is_same_photo(near, second))
        return Matches(*(values[is_kept] for values in astuple(matches)))

    for module in (placement, stillness):
        monkeypatch.setattr(module, "match_features", only_the_marker_in_near)
    assert measured([left, near]).items[0].flags[-1] == "few_matches"
    both = measured([left, near, far])
    assert (both.failure, both.second_place) == (None, 2)
    assert "few_matches" not in both.items[0].flags


def is_same_photo(photo, view):
    return np.array_equal(photo.pixels_bgr, view.photo.pixels_bgr)


def test_partner_that_is_not_the_right_photograph_is_named(photographs):
    left, near, far, _ = photographs
    third = estimate_meal(PhotoPair(left, far, (near,)), OPTIONS, want_artefacts=True)
    assert (third.second_place, third.parameters["second_view"]) == (2, 3)
    scene = json.loads(next(each.content for each in third.artefacts if each.name == "scene.json"))
    assert list(scene["photographs"]) == ["left"]  # the right photograph's corners were not looked for
    assert not any("right_rings_px" in item for item in scene["items"])


def test_partner_that_fails_leaves_the_pair_as_it_was_sent(photographs, pair):
    cropped = Photo(np.ascontiguousarray(photographs[1].pixels_bgr[:, 40:]))  # no camera of this size
    third = measured([photographs[0], photographs[2], cropped])
    whole = measured([photographs[0], photographs[2]])
    assert third.failure is None
    assert third.second_place == 1
    assert third.items[0].volume_ml == whole.items[0].volume_ml


def test_order_of_the_others_does_not_change_the_volume(photographs, four):
    left, near, far, other = photographs
    again = measured([left, other, near, far])
    assert again.items[0].volume_ml == pytest.approx(four.items[0].volume_ml, rel=1e-6)


def test_photograph_without_a_marker_adds_nothing(photographs, pair):
    blank = Photo(np.full_like(photographs[0].pixels_bgr, 128))
    third = measured([*photographs[:2], blank])
    assert "views" not in third.parameters
    assert third.items[0].volume_ml == pair.items[0].volume_ml


def test_photograph_of_another_scene_adds_nothing(photographs, pair):
    moved = render(look_at(CENTRES_MM[3], (60.0, 0.0, 10.0)), None, 7)  # another cloth, no ball
    third = measured([*photographs[:2], Photo(np.clip(moved, 0, 255).astype(np.uint8))])
    assert third.items[0].volume_ml == pair.items[0].volume_ml


def test_photograph_from_farther_along_the_same_line_of_sight_joins(photographs, pair):
    """It could be no stereo partner of the first, and shows the outline all the same."""
    centre_mm = np.array(CENTRES_MM[0]) * 1.3
    pixels = render(look_at(tuple(centre_mm), (60.0, 0.0, 10.0)), BALL, 0)
    noisy = pixels + np.random.default_rng(9).normal(0.0, 1.0, pixels.shape)
    third = measured([*photographs[:2], Photo(np.clip(noisy + 0.5, 0, 255).astype(np.uint8))])
    assert third.parameters["views"] == 3
    assert third.items[0].volume_ml == pytest.approx(pair.items[0].volume_ml, rel=0.05)
