"""Poses by a phone's tracking: read, refused, turned with the photograph, made a rig, and a meal measured by them."""

import copy
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from app.core.errors import Failure, InvalidInputError
from app.estimates.run_estimate import run_estimate
from app.vision.intrinsics import Camera
from app.vision.known_poses import poses_from_mapping, poses_to_json, rig_of_poses
from app.vision.model import EstimateOptions, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.stereo.rig_pose import POSES_SHIFT_SD_SHARE, POSES_TURN_SD_RAD
from tests.unit.vision.poses import arkit_poses, stored_turn
from tests.unit.vision.rigs import rig_of
from tests.unit.vision.stereo_scene import CAMERA, SPEC, Ball, blank_views, rendered_views
from tests.unit.vision.test_pipeline_of_one import on_plain_table

BALL = Ball((115.0, 15.0), 33.0)
UPRIGHT = {1: None, 3: cv2.ROTATE_180, 6: cv2.ROTATE_90_CLOCKWISE, 8: cv2.ROTATE_90_COUNTERCLOCKWISE}
STORED = {1: None, 3: cv2.ROTATE_180, 6: cv2.ROTATE_90_COUNTERCLOCKWISE, 8: cv2.ROTATE_90_CLOCKWISE}
SIZES = ((CAMERA.width, CAMERA.height),) * 2
TOLERANCE = 0.08  # a rig's bar and the scale that matches leave to exact poses


def sent(**changes):
    return copy.deepcopy(arkit_poses(*blank_views())) | changes


def changed(path, value):
    data = sent()
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return data


def test_poses_are_read_and_written_as_the_same_values():
    poses = poses_from_mapping(sent(gravity=[0.0, -9.8, 0.0]))
    assert poses.up == (0.0, 1.0, 0.0)
    assert poses_from_mapping(poses_to_json(poses)) == poses
    assert poses_from_mapping(sent(convention="opencv")).up is None


@pytest.mark.parametrize(
    "data",
    [
        None,
        [],
        {},
        sent(convention="unity"),
        sent(views={}),
        sent(views=[1, 2]),
        {**sent(), "views": {"left": sent()["views"]["left"]}},
        changed(("views", "left"), [[1.0] * 4] * 3),
        changed(("views", "left", 0), [1.0, 0.0, 0.0]),
        changed(("views", "left", 0), [2.0, 0.0, 0.0, 0.0]),  # no rotation
        changed(("views", "left", 0, 0), math.nan),
        changed(("views", "left", 0, 3), math.inf),
        changed(("views", "left", 0, 3), 1e300),
        changed(("views", "left", 0, 3), 10**400),  # more than any float
        changed(("views", "left", 0, 3), "1"),
        changed(("views", "left", 0, 3), True),
        changed(("views", "left", 3), [0.1, 0.2, 0.3, 1.0]),  # column by column
        sent(views={side: sent()["views"]["left"] for side in ("left", "right")}),  # no way between them
        changed(("views", "left", 0, 3), 60.0),  # millimetres
        sent(gravity=[0.0, 0.0, 0.0]),
        sent(gravity=[0.0, 0.0]),
    ],
)
def test_poses_that_cannot_be_are_refused(data):
    with pytest.raises(InvalidInputError) as raised:
        poses_from_mapping(data)
    assert raised.value.code == "poses_invalid"


@pytest.mark.parametrize("orientation", UPRIGHT)
@pytest.mark.parametrize("orientation_right", [1, 6])
def test_rig_of_poses_is_that_of_the_upright_photographs(orientation, orientation_right):
    views = blank_views()
    orientations = orientation, orientation_right
    rig = rig_of_poses(poses_from_mapping(arkit_poses(*views, orientations)), CAMERA, SIZES, orientations)
    known = rig_of(*views)
    assert np.allclose(rig.rotation, known.rotation, atol=1e-7)
    assert np.allclose(rig.translation_mm, known.translation_mm, atol=1e-6)
    assert np.allclose(rig.up, views[0].rotation[:, 2], atol=1e-9)  # the table's z
    assert rig.source == "poses"


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_turn_of_the_stored_picture_is_that_of_its_pixels(orientation):
    """The tests' own turn of the axes is what OpenCV does to pixels: a mark lands where it says."""
    stored = np.zeros((30, 40), np.uint8)
    stored[7, 31] = 255
    upright = stored if UPRIGHT[orientation] is None else cv2.rotate(stored, UPRIGHT[orientation])
    row, column = np.argwhere(upright)[0]
    middle = (np.array(upright.shape[::-1]) - 1) / 2
    seen = stored_turn(orientation) @ [31 - 19.5, 7 - 14.5, 1.0]
    assert np.allclose(seen[:2], [column, row] - middle)


def test_opencv_poses_are_of_the_upright_photograph_whatever_exif_says():
    views = blank_views()
    data = arkit_poses(*views)
    for pose in data["views"].values():
        for row in pose[:3]:
            row[1], row[2] = -row[1], -row[2]
    poses = poses_from_mapping(data | {"convention": "opencv", "gravity": [0.0, -1.0, 0.0]})
    rig = rig_of_poses(poses, CAMERA, SIZES, (6, 8))
    assert np.allclose(rig.rotation, rig_of(*views).rotation, atol=1e-7)
    assert np.allclose(rig.up, views[0].rotation[:, 2], atol=1e-9)


def test_camera_of_another_shape_is_a_mismatch():
    square = Camera(1000, 1000, 900.0, 900.0, 500.0, 500.0)
    failed = rig_of_poses(poses_from_mapping(sent()), square, SIZES, (1, 1))
    assert isinstance(failed, Failure)
    assert failed.code == "camera_mismatch"


@pytest.fixture(scope="module")
def views():
    return rendered_views(BALL)


def measured(views, data, marker=None, **options):
    pair = PhotoPair(*(view.photo for view in views))
    options = {"camera": CAMERA, "poses": poses_from_mapping(data)} | options
    return estimate_meal(pair, EstimateOptions(marker, **options))


def ball_of(estimate):
    assert estimate.failure is None, estimate.failure.message
    return max(estimate.items, key=lambda item: item.volume_ml)


@pytest.fixture(scope="module")
def by_exact_poses(views):
    return ball_of(measured(views, arkit_poses(*views)))


def test_ball_has_its_volume_by_exact_poses(by_exact_poses):
    assert abs(by_exact_poses.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert "scale_from_poses" in by_exact_poses.flags


def test_interval_holds_the_doubt_of_the_scale(by_exact_poses):
    assert by_exact_poses.relative_sd["pair"] > 0.9 * 3 * POSES_SHIFT_SD_SHARE  # lengths cubed


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_poses_as_exact_as_tracking_is_leave_the_volume_in_its_interval(views, seed):
    rng = np.random.default_rng(seed)
    left, right = views
    turn = cv2.Rodrigues(rng.normal(0.0, POSES_TURN_SD_RAD, 3))[0]
    shift_mm = rng.normal(0.0, POSES_SHIFT_SD_SHARE * rig_of(*views).baseline_mm, 3)
    off = replace(right, rotation=turn @ right.rotation, translation_mm=turn @ right.translation_mm + shift_mm)
    ball = ball_of(measured(views, arkit_poses(left, off)))
    low_ml, high_ml = ball.volume_interval_ml
    assert low_ml < BALL.volume_ml < high_ml


@pytest.mark.slow
def test_poses_twice_as_far_apart_give_lengths_twice_as_long(views, by_exact_poses):
    data = arkit_poses(*views)
    for pose in data["views"].values():
        for row in pose[:3]:
            row[3] *= 2
    twice = ball_of(measured(views, data))
    assert twice.volume_ml == pytest.approx(8 * by_exact_poses.volume_ml, rel=0.1)  # other steps of the same search


def covered(view):
    """The view with a plain cloth on its board."""
    pixels = view.photo.pixels_bgr.copy()
    hull = cv2.convexHull(np.rint(view.marker.corners_px).astype(np.int32))
    mask = cv2.dilate(cv2.fillConvexPoly(np.zeros(pixels.shape[:2], np.uint8), hull, 255), np.ones((91, 91), np.uint8))
    noise = np.random.default_rng(0).normal(120.0, 2.0, pixels.shape)
    return replace(view, photo=Photo(np.where(mask[..., None] > 0, noise, pixels).astype(np.uint8)))


@pytest.mark.slow
def test_marker_decides_the_scale_where_it_is_seen(views):
    alone = measured(views, arkit_poses(*views), SPEC, poses=None)
    both = measured(views, arkit_poses(*views), SPEC)
    assert [item.volume_ml for item in both.items] == [item.volume_ml for item in alone.items]
    assert all("scale_from_poses" not in item.flags for item in both.items)


@pytest.mark.slow
def test_poses_give_the_scale_where_the_marker_is_not_seen(views, by_exact_poses):
    bare = [covered(view) for view in views]
    assert measured(bare, arkit_poses(*views), SPEC, poses=None).failure.code == "marker_not_found"
    ball = ball_of(measured(bare, arkit_poses(*views), SPEC))
    assert "scale_from_poses" in ball.flags
    assert ball.volume_ml == pytest.approx(by_exact_poses.volume_ml, rel=0.03)  # the same scene with less to match


def test_poses_give_the_scale_where_the_marker_is_seen_in_the_left_photograph_only(views, by_exact_poses):
    estimate = measured([views[0], covered(views[1])], arkit_poses(*views), SPEC)
    ball = ball_of(estimate)
    assert ball.flags == by_exact_poses.flags
    assert "single_view" not in ball.flags
    assert estimate.parameters["scale_source"] == "poses"
    assert ball.volume_ml == pytest.approx(by_exact_poses.volume_ml, rel=0.03)  # the same scene with less to match
    assert [colour.kind for colour in estimate.colours] == ["white", "none"]  # what the marker tells of colours stays


@pytest.mark.slow
def test_left_photograph_with_the_marker_is_measured_where_poses_do_not_help(views):
    photographs = [replace(views[0], photo=on_plain_table(views[0].photo)), covered(views[1])]
    of_each_other = arkit_poses(*views[::-1])
    assert measured(photographs, of_each_other).failure.code in ("poses_mismatch", "table_not_found")
    lost, without = (measured(photographs, of_each_other, SPEC, **options) for options in ({}, {"poses": None}))
    assert "single_view" in ball_of(lost).flags
    assert ball_of(lost).volume_ml == ball_of(without).volume_ml


def test_poses_whose_table_is_not_the_markers_leave_the_left_photograph_alone(views):
    photographs = [replace(views[0], photo=on_plain_table(views[0].photo)), covered(views[1])]
    data = arkit_poses(*views)
    for pose in data["views"].values():
        for row in pose[:3]:
            row[3] *= 1.5  # by which all lengths are off
    ball = ball_of(measured(photographs, data, SPEC))
    assert "single_view" in ball.flags
    assert abs(ball.volume_ml / BALL.volume_ml - 1) < 0.25


def test_poses_without_intrinsics_fail(views):
    assert measured(views, arkit_poses(*views), camera=None).failure.code == "focal_unknown"


def test_poses_of_other_photographs_do_not_fit(views):
    other = blank_views(roll_deg=25.0)
    assert measured(views, arkit_poses(views[0], other[1])).failure.code == "poses_mismatch"


def test_photographs_without_anything_to_match_do_not_fit():
    views = blank_views()
    greys = [np.full_like(view.photo.pixels_bgr, grey) for view, grey in zip(views, (120, 130), strict=True)]
    failed = measured([replace(views[0], photo=Photo(grey)) for grey in greys], arkit_poses(*views))
    assert failed.failure.code == "poses_mismatch"


def estimated_from_files(views, folder, data, orientations, written):
    paths = {}
    for side, view, orientation, tag in zip(("left", "right"), views, orientations, written, strict=True):
        pixels, turn = view.photo.pixels_bgr, STORED[orientation]
        stored = pixels if turn is None else cv2.rotate(pixels, turn)
        paths[side] = folder / f"{side}.png"
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = tag
        Image.fromarray(stored[..., ::-1]).save(paths[side], exif=exif)
    options = EstimateOptions(None, camera=CAMERA, poses=poses_from_mapping(data))
    return run_estimate(paths, options, max_pixels=10**7, on_stage=lambda _: None, want_artefacts=False)[0]


@pytest.mark.slow
def test_poses_of_a_turned_sensor_are_turned_with_the_photograph(views, tmp_path, by_exact_poses):
    orientations = (6, 8)
    data = arkit_poses(*views, orientations)
    answer = estimated_from_files(views, tmp_path, data, orientations, orientations)
    assert answer.failure is None
    assert max(item.volume_ml for item in answer.items) == pytest.approx(by_exact_poses.volume_ml, rel=1e-3)


def test_poses_of_a_turned_sensor_fail_where_the_file_lost_its_orientation(views, tmp_path):
    """An app that turned the pixels itself: the axes are no longer those of the stored picture."""
    answer = estimated_from_files(views, tmp_path, arkit_poses(*views, (6, 6)), (1, 1), (1, 1))
    assert answer.failure.code in ("poses_mismatch", "table_not_found")
