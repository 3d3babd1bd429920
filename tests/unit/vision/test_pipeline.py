"""The whole way on a rendered ball, whose volume is known; and what scenes that cannot be measured answer."""

import json
from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest

from app.vision.board.colour_correction import apply_colour
from app.vision.board.colour_space import encode_srgb, linear_rgb
from app.vision.model import EstimateOptions, Hint, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.shape.tuning import TUNING
from app.vision.version import PIPELINE_VERSION
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, rendered_views

BALL = Ball((115.0, 15.0), 33.0)
STAGES = ["marker", "camera", "match", "rectify", "disparity", "depth", "segment", "volume", "describe"]
OPTIONS = EstimateOptions(SPEC, CAMERA)
TOLERANCE = 0.12  # the paper's own method errs by 7.7 % on the mean of six fruit; this is one ball


def photographs(ball=BALL, roll_deg=0.0):
    left, right = rendered_views(ball, roll_deg)
    return PhotoPair(left.photo, right.photo)


@pytest.fixture(scope="module")
def pair():
    return photographs()


@pytest.fixture(scope="module")
def estimate(pair):
    return estimate_meal(pair, OPTIONS, want_artefacts=True)


@pytest.fixture(scope="module")
def again(pair):
    """The same once more without artefacts, with the stages that were heard and the photograph as it was before."""
    heard, before = [], pair.left.pixels_bgr.copy()
    return estimate_meal(pair, OPTIONS, on_stage=heard.append), heard, before


def ball_mask(pair):
    left = rendered_views(None)[0]
    middle = np.array([*BALL.centre_mm, BALL.radius_mm])
    x = left.rotation @ middle + left.translation_mm
    centre = x[:2] / x[2] * CAMERA.fx + [CAMERA.cx, CAMERA.cy]
    mask = np.zeros(pair.left.pixels_bgr.shape[:2], np.uint8)
    radius = CAMERA.fx * BALL.radius_mm / np.sqrt(x[2] ** 2 - BALL.radius_mm**2)
    cv2.circle(mask, tuple(round(float(v)) for v in centre), int(radius), 1, -1)
    return mask > 0


def test_ball_has_its_volume_and_its_outline(estimate, pair):
    assert estimate.failure is None
    assert len(estimate.items) == 1
    item = estimate.items[0]
    assert abs(item.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert item.volume_interval_ml[0] < BALL.volume_ml < item.volume_interval_ml[1]
    drawn = np.zeros(pair.left.pixels_bgr.shape[:2], np.uint8)
    cv2.fillPoly(drawn, [np.rint(ring).astype(np.int32) for ring in item.rings], 1)
    truth = ball_mask(pair)
    assert np.count_nonzero((drawn > 0) & truth) / np.count_nonzero((drawn > 0) | truth) > 0.85


@pytest.mark.slow
def test_outline_that_is_sent_back_as_it_was_given_measures_the_same_volume(estimate, pair):
    (item,) = estimate.items
    rings = tuple(tuple(map(tuple, ring.tolist())) for ring in item.rings)
    (again,) = estimate_meal(pair, replace(OPTIONS, hints=(Hint(polygon=rings),))).items
    assert again.volume_ml == pytest.approx(item.volume_ml, rel=0.03)  # 1.5 px of an outline 200 px across, twice


def test_stages_are_told_and_timed_in_order(again):
    estimate, heard, _ = again
    assert heard == STAGES
    assert list(estimate.stages) == STAGES
    assert estimate.pipeline_version == PIPELINE_VERSION
    assert estimate.artefacts == ()


def test_every_step_leaves_its_picture(estimate):
    pictures = {each.name: each for each in estimate.artefacts}
    assert set(pictures) == {
        "matches.jpg",
        "rectified_by_f.jpg",
        "rectified.jpg",
        "disparity.jpg",
        "points.jpg",
        "points.ply",
        "slices.jpg",
        "overlay.jpg",
        "scene.json",
    }
    for name, each in pictures.items():
        if name.endswith(".jpg"):
            picture = cv2.imdecode(np.frombuffer(each.content, np.uint8), cv2.IMREAD_COLOR)
            assert 0 < picture.shape[1] <= 1600
            assert picture.std() > 5
        else:
            assert each.content.startswith(b"ply\n" if name == "points.ply" else b'{"version":')


def test_same_seed_gives_the_same_answer(estimate, again):
    again, _, _ = again
    assert again.items[0].volume_ml == estimate.items[0].volume_ml
    assert again.parameters == estimate.parameters
    assert again.parameters["tuning"] == asdict(TUNING)


def test_swapped_photographs_give_the_same_volume(estimate, pair):
    swapped = estimate_meal(PhotoPair(pair.right, pair.left), OPTIONS)
    assert swapped.parameters["swapped"] == 1
    # The poses are fitted in another order: equal but for the solver's tolerance and what hangs on it.
    assert np.isclose(swapped.items[0].volume_ml, estimate.items[0].volume_ml, rtol=0.02)
    shift = swapped.items[0].rings[0].mean(axis=0) - estimate.items[0].rings[0].mean(axis=0)
    assert np.abs(shift).max() > 5  # outlines are in the photograph sent as left, here the right one


def test_phone_on_its_side_gives_the_same_volume():
    estimate = estimate_meal(photographs(roll_deg=90.0), OPTIONS)
    assert abs(estimate.items[0].volume_ml / BALL.volume_ml - 1) < TOLERANCE


def test_hint_is_answered_and_its_form_used(pair):
    rows, columns = np.nonzero(ball_mask(pair))
    hint = Hint(point=(float(columns.mean()), float(rows.mean())), food="orange", slice_form="circle")
    estimate = estimate_meal(pair, replace(OPTIONS, hints=(hint,)))
    assert [item.hint for item in estimate.items] == [0]


def test_hint_that_hits_nothing_is_flagged_and_the_food_is_measured_and_drawn_all_the_same(pair, estimate):
    """A point outside the photograph made a whole meal `no_food_found`, and one on bare table lost what was seen."""
    outside, of_apple = Hint(point=(99_999.0, 5.0), food="pear"), Hint(food="apple")
    hinted = estimate_meal(pair, replace(OPTIONS, hints=(of_apple, outside)), want_artefacts=True)
    assert [item.hint for item in hinted.items] == [None, 1]
    measured, missed = hinted.items
    assert measured.volume_ml == pytest.approx(estimate.items[0].volume_ml)
    (scene,) = [json.loads(each.content) for each in hinted.artefacts if each.name == "scene.json"]
    assert len(scene["items"]) == 1
    assert (missed.volume_ml, missed.rings, missed.flags) == (None, (), ("not_measurable", "hint_missed"))


def test_table_without_food_says_so_and_shows_how_far_it_came():
    estimate = estimate_meal(photographs(None), OPTIONS, want_artefacts=True)
    assert estimate.failure.code == "no_food_found"
    assert estimate.failure.advice
    assert estimate.items == ()
    assert estimate.views is not None
    assert {"matches.jpg", "disparity.jpg"} <= {each.name for each in estimate.artefacts}


def test_photograph_without_marker_says_so(pair):
    grey = Photo(np.full_like(pair.left.pixels_bgr, 128))
    estimate = estimate_meal(PhotoPair(grey, pair.right), OPTIONS)
    assert estimate.failure is not None
    assert estimate.views is None
    assert estimate.colours is None
    assert list(estimate.stages) == ["marker"]


def tinted(photo, gains):
    """As another light or white balance makes it. gains: red, green, blue."""
    linear = linear_rgb(photo.pixels_bgr) * gains
    return Photo(np.ascontiguousarray(np.rint(255 * encode_srgb(linear)).astype(np.uint8)[..., ::-1]))


def test_colours_are_corrected_for_each_photograph_and_do_not_follow_its_light(estimate, pair):
    """The photographs swapped as well, so that the first view is the right one."""
    gains = {"left": np.array([0.9, 0.7, 0.5]), "right": np.array([0.5, 0.7, 0.9])}
    views = PhotoPair(tinted(pair.right, gains["right"]), tinted(pair.left, gains["left"]))
    found = estimate_meal(views, OPTIONS, want_artefacts=True)
    assert [each.kind for each in estimate.colours] == ["white", "white"]
    for before, after, gain in zip(estimate.colours, found.colours[::-1], gains.values(), strict=True):
        assert np.diag(after.matrix) * gain == pytest.approx(np.diag(before.matrix), rel=0.03)
    assert found.items[0].traits.lab == pytest.approx(estimate.items[0].traits.lab, abs=2.0)
    (overlay,) = [each for each in found.artefacts if each.name == "overlay.jpg"]
    picture = cv2.imdecode(np.frombuffer(overlay.content, np.uint8), cv2.IMREAD_COLOR)
    table = np.median(picture.reshape(-1, 3), axis=0)
    as_taken = np.median(views.left.pixels_bgr.reshape(-1, 3), axis=0)
    untinted = np.median(apply_colour(pair.right.pixels_bgr, estimate.colours[1]).reshape(-1, 3), axis=0)
    assert table == pytest.approx(untinted, abs=4.0)
    assert np.abs(as_taken - untinted).max() > 20.0


def test_photographs_are_not_modified(pair, again):
    _, _, before = again
    assert np.array_equal(pair.left.pixels_bgr, before)


def test_method_as_printed_leaves_its_depth_in_the_record_and_its_shape_in_the_scene(pair):
    options = replace(OPTIONS, method="paper-strict")
    estimates = [estimate_meal(pair, replace(options, seed=seed), want_artefacts=True) for seed in (0, 0)]
    first, again = estimates
    assert first.method == "paper-strict"
    assert first.parameters["printed_depth_q_mm_px"] == again.parameters["printed_depth_q_mm_px"]
    (item,) = first.items
    assert item.volume_ml == again.items[0].volume_ml
    scene = json.loads(next(each.content for each in first.artefacts if each.name == "scene.json"))
    # The stack of slices and its mirror image enclose twice the sum of V_k (eq. 15).
    assert np.isclose(scene["items"][0]["mesh_volume_ml"], item.volume_ml, rtol=0.01)


def test_method_as_printed_needs_a_marker(pair):
    with pytest.raises(ValueError, match="marker"):
        estimate_meal(pair, EstimateOptions(None, CAMERA, "paper-strict"))
