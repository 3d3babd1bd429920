"""More than two photographs of one scene: the best partner is chosen; others join in any order, or add nothing."""

import numpy as np
import pytest

from app.vision.model import EstimateOptions, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.views.other_views import stereo_partners
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
    assert item.volume_ml == pytest.approx(BALL.volume_ml, rel=0.02)
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
def test_partner_that_is_not_the_right_photograph_is_named(photographs, scene_of):
    left, near, far, _ = photographs
    third = measured([left, far, near], want_artefacts=True)
    assert (third.second_place, third.parameters["second_view"]) == (2, 3)
    scene = scene_of(third)
    assert list(scene["photographs"]) == ["left"]  # the right photograph's corners were not looked for
    assert not any("right_rings_px" in item for item in scene["items"])


@pytest.mark.slow
def test_photographs_without_a_marker_and_of_another_scene_add_nothing(photographs, estimate):
    blank = Photo(np.full_like(photographs[0].pixels_bgr, 128))
    more = measured([*photographs[:2], blank, photographed(OTHER_MM, None, cloth=7)])
    assert "views" not in more.parameters
    assert more.items[0].volume_ml == estimate.items[0].volume_ml
