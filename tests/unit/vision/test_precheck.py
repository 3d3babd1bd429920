"""Pairs judged before they are sent: what the pipeline measures passes, what it cannot measure is stopped."""

import pathlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.core.errors import Failure
from app.vision.board.camera import camera_from_exif
from app.vision.board.marker import find_marker
from app.vision.intrinsics import Camera
from app.vision.marker_spec import parse_marker
from app.vision.model import Photo
from app.vision.photograph.photo import ReducedPhoto, read_photo, read_reduced_photo
from app.vision.precheck import check_pair
from tests.support.scenes import both, load_scene, right_only, scaled, with_marker_moved

PAIR = pathlib.Path(__file__).parents[3] / "app" / "demo_data"
BOARD = parse_marker("plain:9x7:11")


@pytest.fixture(scope="module")
def photos():
    return {side: read(side) for side in ("left", "right")}


def read(side):
    found = read_reduced_photo((PAIR / f"{side}.jpg").read_bytes(), max_pixels=10**8, least_long_side_px=1600)
    assert isinstance(found, ReducedPhoto)
    return found


def changed(photo, change):
    pixels = np.ascontiguousarray(change(photo.photo.pixels_bgr))
    return ReducedPhoto(replace(photo.photo, pixels_bgr=pixels), photo.factor)


def check(left, right, spec=BOARD, camera=None):
    found = check_pair(left, right, spec, camera)
    assert found.is_ok == (not stops(found))
    return found


def stops(found):
    return {(problem.code, problem.side) for problem in found.problems if problem.severity == "stop"}


def warnings(found):
    return {(problem.code, problem.side) for problem in found.problems if problem.severity == "warn"}


def of_scene(pair):
    return [ReducedPhoto(photo, 2) for photo in (both(pair, scaled(0.5)).left, both(pair, scaled(0.5)).right)]


def test_bundled_pair_has_no_problem_and_its_measures_are_those_of_the_scene(photos):
    found = check(photos["left"], photos["right"])
    assert found.problems == ()
    assert found.measures["view_angle_deg"] == pytest.approx(7.6, abs=1.0)
    assert found.measures["matches"] > 20
    assert check(photos["right"], photos["left"]).problems == ()


def test_unread_photograph_is_told_with_its_code_and_the_other_one_is_judged_all_the_same(photos):
    dark = changed(photos["right"], lambda pixels: pixels // 12)
    found = check(Failure("image_truncated", "", ""), dark)
    assert stops(found) == {("image_truncated", "left"), ("image_too_dark", "right")}


def test_same_photograph_twice_another_board_and_blank_photographs_are_stopped(photos):
    assert stops(check(photos["left"], photos["left"])) == {("same_photograph", None)}
    other = check(photos["left"], photos["right"], parse_marker("plain:8x6:11"))
    assert stops(other) == {("marker_mismatch", "left"), ("marker_mismatch", "right")}
    blank = ReducedPhoto(Photo(np.full((1200, 1600, 3), 128, np.uint8)), 1)
    assert {code for code, _ in stops(check(blank, blank))} <= {"marker_not_found", "image_blurred"}
    assert not check(blank, blank).is_ok


def test_blur_stops_where_the_pipeline_stops_and_warns_before(photos):
    told = []
    for sigma in (0.0, 3.0, 4.0, 8.0):
        soft = changed(photos["left"], lambda pixels, s=sigma: cv2.GaussianBlur(pixels, (0, 0), s) if s else pixels)
        quick = check(soft, photos["right"])
        thorough = find_marker(soft.photo, BOARD)
        is_blurred = isinstance(thorough, Failure) and thorough.code == "image_blurred"
        assert (("image_blurred", "left") in stops(quick)) == is_blurred
        told.append((("image_blurred", "left") in warnings(quick), ("image_blurred", "left") in stops(quick)))
    assert told[0] == (False, False)
    assert (True, False) in told
    assert told[-1] == (False, True)


def test_reflection_on_the_board_warns(photos):
    corners = find_marker(photos["left"].photo, BOARD).corners_px.reshape(6, 8, 2)
    dark = (corners[2, 2] + corners[3, 3]) / 2  # of a square that is printed dark or its neighbour
    step = corners[2, 3] - corners[2, 2]

    def shine(pixels):
        lit = pixels.copy()
        for shift in (0, 1):
            middle = np.rint(dark + shift * step).astype(int)
            cv2.circle(lit, tuple(int(v) for v in middle), int(np.linalg.norm(step) * 0.45), (225, 225, 225), -1)
        return lit

    assert ("marker_glare", "left") in warnings(check(changed(photos["left"], shine), photos["right"]))


def test_small_photograph_warns_of_its_resolution_and_large_one_of_distance(photos):
    small = [changed(photos[side], scaled(0.5)) for side in ("left", "right")]
    assert ("resolution_low", "left") in warnings(check(*small))

    def far(photo):  # the same view seen from further off: as many pixels, half of them the meal
        height, width = photo.photo.pixels_bgr.shape[:2]
        pixels = scaled(0.5)(photo.photo.pixels_bgr)
        around = (height // 4, height - height // 4 - pixels.shape[0], width // 4, width - width // 4 - pixels.shape[1])
        return changed(photo, lambda _: cv2.copyMakeBorder(pixels, *around, cv2.BORDER_REPLICATE))

    assert ("marker_too_small", "left") in warnings(check(far(photos["left"]), far(photos["right"])))


def test_food_at_the_border_warns(photos):
    """The photograph ends in the midst of the apple: its matched points crowd at that border."""
    apple = 1092  # its middle's column in the left photograph (tests/integration/meals/upload/test_bad_scenes.py)
    height, width = photos["left"].photo.pixels_bgr.shape[:2]
    focal_px = camera_from_exif(photos["left"].photo).fx
    camera = Camera(apple, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
    found = check(*(changed(photos[side], lambda pixels: pixels[:, :apple]) for side in photos), camera=camera)
    assert stops(found) == set()
    assert ("food_near_border", "left") in warnings(found)


@pytest.mark.parametrize(("least", "factor"), [(None, 1), (817, 1), (816, 2), (408, 4)])
def test_photograph_is_averaged_but_keeps_the_least_long_side(least, factor):
    found = read_reduced_photo((PAIR / "left.jpg").read_bytes(), max_pixels=10**8, least_long_side_px=least)
    assert found.factor == factor
    assert max(found.photo.pixels_bgr.shape) == -(-1632 // factor)
    whole = read_photo((PAIR / "left.jpg").read_bytes(), max_pixels=10**8)
    averaged = cv2.resize(whole.pixels_bgr, found.photo.pixels_bgr.shape[1::-1], interpolation=cv2.INTER_AREA)
    # the cosine transform leaves out what averaging only dampens
    assert np.abs(found.photo.pixels_bgr.astype(float) - averaged).mean() < 3.0
    assert found.photo.focal_35mm == whole.focal_35mm


@pytest.mark.slow
@pytest.mark.parametrize("name", ["meal-01", "hard-01-touching", "apple-2"])
def test_rendered_pairs_of_two_scenes_or_whose_marker_was_pushed_are_stopped_as_the_pipeline_does(shared_data, name):
    scene, other = load_scene(shared_data, name), load_scene(shared_data, "orange-2")
    for moved_mm in ((0.0, 40.0), (-40.0, 30.0)):
        found = check(*of_scene(with_marker_moved(scene, *moved_mm)), scene.spec)
        assert stops(found)
        assert {code for code, _ in stops(found)} <= {"scene_moved", "too_few_matches", "pose_unreliable"}
    mixed = right_only(scene.pair, lambda _: other.pair.right.pixels_bgr)
    assert stops(check(*of_scene(mixed), scene.spec))
