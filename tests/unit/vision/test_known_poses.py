"""Poses by a phone's tracking: read, refused, turned with the photograph, made a rig, and a meal measured by them."""

import copy
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from app.core.errors import InvalidInputError
from app.meals.estimate.run_estimate import run_estimate
from app.vision.intrinsics import Camera
from app.vision.known_poses import poses_from_mapping, rig_of_poses
from app.vision.model import EstimateOptions, Photo, PhotoPair
from app.vision.pipeline import estimate_meal
from app.vision.views.rig_pose import POSES_SHIFT_SD_SHARE
from tests.unit.vision.poses import arkit_poses
from tests.unit.vision.rigs import rig_of
from tests.unit.vision.stereo_scene import BALL, CAMERA, SPEC, blank_views, covered

STORED = {1: None, 3: cv2.ROTATE_180, 6: cv2.ROTATE_90_COUNTERCLOCKWISE, 8: cv2.ROTATE_90_CLOCKWISE}
SIZES = ((CAMERA.width, CAMERA.height),) * 2
TOLERANCE = 0.08  # a rig's target and the scale that matches leave to exact poses


def sent(**changes):
    return copy.deepcopy(arkit_poses(*blank_views())) | changes


def changed(path, value):
    data = sent()
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return data


LEFT = sent()["views"]["left"]
X = ("views", "left", 0, 3)
NO_NUMBERS = [changed(X, value) for value in (1e300, 10**400, "1", True)] + [changed(("views", "left", 0, 0), math.nan)]
NO_ROWS = [changed(("views", "left"), [[1.0] * 4] * 3), changed(("views", "left", 0), [1.0, 0.0, 0.0])]
NO_POSES = [
    changed(("views", "left", 0), [2.0, 0.0, 0.0, 0.0]),  # no rotation
    changed(("views", "left", 3), [0.1, 0.2, 0.3, 1.0]),  # column by column
    sent(views={"left": LEFT, "right": LEFT}),  # no way between them
    changed(X, 60.0),  # millimetres
    sent(gravity=[0.0, 0.0, 0.0]),
    sent(gravity=[0.0, 0.0]),
]
NO_VIEWS = [None, {}, sent(convention="unity"), sent(views=[1, 2]), sent(views={"left": LEFT})]


@pytest.mark.parametrize("data", NO_VIEWS + NO_ROWS + NO_NUMBERS + NO_POSES)
def test_poses_that_cannot_be_are_refused(data):
    with pytest.raises(InvalidInputError) as raised:
        poses_from_mapping(data)
    assert raised.value.code == "poses_invalid"


@pytest.mark.parametrize("orientations", [(1, 1), (6, 8), (3, 6), (8, 1)])
def test_rig_of_poses_is_that_of_the_upright_photographs(orientations):
    views = blank_views()
    rig = rig_of_poses(poses_from_mapping(arkit_poses(*views, orientations)), CAMERA, SIZES, orientations)
    known = rig_of(*views)
    assert np.allclose(rig.rotation, known.rotation, atol=1e-7)
    assert np.allclose(rig.translation_mm, known.translation_mm, atol=1e-6)
    assert np.allclose(rig.up, views[0].rotation[:, 2], atol=1e-9)  # the table's z
    assert rig.source == "poses"
    square = Camera(1000, 1000, 900.0, 900.0, 500.0, 500.0)
    failed = rig_of_poses(poses_from_mapping(sent()), square, SIZES, orientations)
    assert failed.code == "camera_mismatch"


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


def measured(views, data, marker=None, **options):
    photographs = PhotoPair(*(view.photo for view in views))
    options = {"camera": CAMERA, "poses": poses_from_mapping(data)} | options
    return estimate_meal(photographs, EstimateOptions(marker, **options))


def ball_of(estimate):
    assert estimate.failure is None, estimate.failure.message
    return max(estimate.items, key=lambda item: item.volume_ml)


@pytest.fixture(scope="module")
def by_exact_poses(views):
    return ball_of(measured(views, arkit_poses(*views)))


@pytest.mark.slow
def test_ball_has_its_volume_by_exact_poses_in_an_interval_that_holds_the_doubt_of_the_scale(by_exact_poses):
    assert abs(by_exact_poses.volume_ml / BALL.volume_ml - 1) < TOLERANCE
    assert "scale_from_poses" in by_exact_poses.flags
    assert by_exact_poses.relative_sd["pair"] > 0.9 * 3 * POSES_SHIFT_SD_SHARE  # lengths cubed


@pytest.mark.slow
def test_marker_decides_the_scale_where_it_is_seen(views, estimate):
    both = measured(views, arkit_poses(*views), SPEC)
    assert [item.volume_ml for item in both.items] == [item.volume_ml for item in estimate.items]
    assert all("scale_from_poses" not in item.flags for item in both.items)


@pytest.mark.slow
def test_poses_give_the_scale_where_the_marker_is_not_seen(views, by_exact_poses):
    bare = [covered(view) for view in views]
    ball = ball_of(measured(bare, arkit_poses(*views), SPEC))
    assert "scale_from_poses" in ball.flags
    assert ball.volume_ml == pytest.approx(by_exact_poses.volume_ml, rel=0.03)  # the same scene with less to match


def test_poses_of_other_or_blank_photographs_and_poses_without_intrinsics_fail(views):
    other = blank_views(roll_deg=25.0)
    assert measured(views, arkit_poses(views[0], other[1])).failure.code == "poses_mismatch"
    greys = [replace(view, photo=Photo(np.full_like(view.photo.pixels_bgr, 120 + k))) for k, view in enumerate(other)]
    assert measured(greys, arkit_poses(*other)).failure.code == "poses_mismatch"  # nothing to match
    assert measured(views, arkit_poses(*views), camera=None).failure.code == "focal_unknown"


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
