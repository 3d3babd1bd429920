"""Intrinsics adapted and read, and poses found: against known cameras, and on the rendered meals."""

import math
from dataclasses import replace

import numpy as np
import pytest

from app.core.errors import Failure, InvalidInputError
from app.vision.board.camera import camera_from_exif, estimate_views
from app.vision.board.pose import bent_points
from app.vision.intrinsics import Camera, adapt_camera, camera_from_mapping
from app.vision.marker_spec import parse_marker
from app.vision.model import EstimateOptions, MarkerObservation, Photo, PhotoPair, View
from tests.unit.vision.synthetic import PHONE, Pose, corner_points, look_at, project

SPEC = parse_marker("plain:9x7:11")


GIVEN = {"width": 1200, "height": 900, "fx": 975, "fy": 975.5, "cx": 599.5, "cy": 449.5}
GIVEN["distortion"] = [0.1, -0.1, 0, 0, 0]
DIAGONAL = math.hypot(36, 24)
LEFT, RIGHT = look_at(50, -95, target_mm=(40, 0, 0)), look_at(48, -84, 360, roll_deg=3, target_mm=(40, 0, 0))


def blank(camera: Camera, focal_35mm: float | None = None, grey: int = 0) -> Photo:
    return Photo(np.full((camera.height, camera.width, 3), grey, np.uint8), focal_35mm=focal_35mm)


def observed(camera, pose, spec=SPEC, bend_mm=(0.0, 0.0, 0.0), noise_px=0.0, seed=0) -> MarkerObservation:
    corners = project(camera, pose, bent_points(spec, np.array(bend_mm)))
    return MarkerObservation(spec, corners + np.random.default_rng(seed).normal(0, noise_px or 1e-12, corners.shape))


def outcome(cameras=(PHONE, PHONE), poses=(LEFT, RIGHT), given=PHONE, focal_35mm=(None, None), **kwargs):
    observations = tuple(
        observed(camera, pose, seed=seed, **kwargs)
        for seed, (camera, pose) in enumerate(zip(cameras, poses, strict=True))
    )
    pair = PhotoPair(blank(cameras[0], focal_35mm[0]), blank(cameras[1], focal_35mm[1], grey=1))
    return estimate_views(pair, observations, EstimateOptions(SPEC, given))


def estimate(**kwargs) -> tuple[View, View]:
    views = outcome(**kwargs)
    assert not isinstance(views, Failure), views
    return views


def turned_deg(view: View, pose: Pose) -> float:
    return math.degrees(math.acos(np.clip((np.trace(view.rotation.T @ pose.rotation) - 1) / 2, -1, 1)))


def test_camera_file_is_read():
    camera = camera_from_mapping(GIVEN | {"rms_px": 0.2})
    assert camera == Camera(1200, 900, 975.0, 975.5, 599.5, 449.5, (0.1, -0.1, 0.0, 0.0, 0.0), "given")


BAD_SIZES = [{"width": 0}, {"width": 1200.5}, {"fx": "975"}, {"fx": 0}, {"fy": float("nan")}, {"fy": 1e9}]
BAD_PLACES = [{"cx": -1}, {"cy": 900}, {"cx": True}]
BAD_LENSES = [{"distortion": value} for value in ("none", [0, 0, 0, 0, None], [0, 0, 0, 0, 0, 0])]
CHANGES = [GIVEN | change for change in BAD_SIZES + BAD_PLACES + BAD_LENSES]


@pytest.mark.parametrize("data", [None, {}, {"width": 1200}, *CHANGES])
def test_impossible_camera_file_is_refused(data):
    with pytest.raises(InvalidInputError) as refused:
        camera_from_mapping(data)
    assert refused.value.code == "camera_invalid"
    assert refused.value.message.endswith(".")


@pytest.mark.parametrize("size", [(600, 450), (1200, 900), (1201, 901)])
def test_scaled_camera_sees_the_scaled_pixel(size):
    camera = replace(PHONE, cx=580.0, cy=470.0, distortion=(0.1, -0.1, 1e-3, -2e-3, 0.0))
    scaled = adapt_camera(camera, *size)
    assert (scaled == camera) == (size == (1200, 900))
    points = corner_points(SPEC)
    ratio = np.array(size) / (1200, 900)
    expected = (project(camera, LEFT, points) + 0.5) * ratio - 0.5  # pixel edges scale, not pixel centres
    assert project(scaled, LEFT, points) == pytest.approx(expected, abs=1e-6)


def test_turned_camera_sees_the_turned_photograph():
    camera = replace(PHONE, cx=580.0, cy=470.0, fy=980.0, distortion=(0.1, -0.1, 1e-3, -2e-3, 0.0))
    turned = adapt_camera(camera, 900, 1200)
    assert isinstance(turned, Camera)
    clockwise = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # of the picture: x right becomes y down
    pose = Pose(clockwise @ LEFT.rotation, clockwise @ LEFT.translation_mm)
    x, y = project(camera, LEFT, corner_points(SPEC)).T
    assert project(turned, pose, corner_points(SPEC)) == pytest.approx(np.stack([899 - y, x], 1), abs=1e-6)
    assert adapt_camera(turned, 1200, 900) == camera


@pytest.mark.parametrize("size", [(1200, 675), (1100, 900), (675, 1200)])
def test_photograph_of_another_shape_is_a_mismatch(size):
    failure = adapt_camera(PHONE, *size)
    assert failure.code == "camera_mismatch"
    assert f"{size[0]} x {size[1]}" in failure.message


def test_equivalent_focal_length_goes_by_the_diagonal():
    camera = camera_from_exif(Photo(np.zeros((2400, 3200, 3), np.uint8), focal_35mm=DIAGONAL))
    assert camera.fx == camera.fy == pytest.approx(4000.0, rel=1e-4)
    assert (camera.cx, camera.cy, camera.source) == (1599.5, 1199.5, "exif")


@pytest.mark.parametrize(
    ("errors", "most_mm", "rms_px"),
    # 48 corners over 88 x 66 mm at 350 mm: 0.1 px are 0.036 mm, and some 0.2 degrees of tilt.
    [({}, 0.05, (0, 0.01)), ({"noise_px": 0.1}, 3.0, (0.14, 0.03)), ({"bend_mm": (1.5, 0.3, -0.5)}, 1.0, (0, 0.1))],
    ids=["exact", "noise", "bent paper, seen through"],
)
def test_given_camera_gives_the_true_poses(errors, most_mm, rms_px):
    for view, pose in zip(estimate(**errors), (LEFT, RIGHT), strict=True):
        assert view.centre_mm == pytest.approx(pose.centre_mm, abs=most_mm)
        assert view.rms_px == pytest.approx(rms_px[0], abs=rms_px[1])
        assert view.centre_mm[2] > 0
        assert view.camera == PHONE
        assert errors or turned_deg(view, pose) < 0.01


@pytest.mark.parametrize("focal_error", [0.93, 1.07])
def test_focal_length_of_exif_is_refined_on_the_board(focal_error):
    told = focal_error * PHONE.fx * DIAGONAL / 1500
    views = estimate(given=None, focal_35mm=(told, told), noise_px=0.05, bend_mm=(1.0, 0, 0))
    assert views[0].camera == views[1].camera
    assert views[0].camera.source == "exif"
    assert views[0].camera.fx == pytest.approx(PHONE.fx, rel=0.03)  # from 7 %
    views = estimate(given=None, noise_px=0.05)  # without EXIF the board tells it
    assert views[0].camera.source == "board"
    assert views[0].camera.fx == pytest.approx(PHONE.fx, rel=0.05)


def test_photographs_of_different_zoom_or_size_have_a_camera_each():
    zoomed = replace(PHONE, fx=1.5 * PHONE.fx, fy=1.5 * PHONE.fy)
    told = PHONE.fx * DIAGONAL / 1500
    views = estimate(cameras=(PHONE, zoomed), given=None, focal_35mm=(told, 1.5 * told))
    assert views[1].camera.fx / views[0].camera.fx == pytest.approx(1.5, rel=0.03)
    assert views[1].centre_mm == pytest.approx(RIGHT.centre_mm, rel=0.03)
    small = adapt_camera(PHONE, 800, 600)  # a given camera is shared, if the sizes differ
    views = estimate(cameras=(PHONE, small))
    assert views[1].camera == small
    assert views[1].centre_mm == pytest.approx(RIGHT.centre_mm, abs=0.05)


def test_corners_of_small_squares_may_be_as_noisy_as_a_small_photograph_makes_them():
    small = replace(PHONE, width=300, height=225, fx=244.0, fy=244.0, cx=149.5, cy=112.0)
    views = estimate(cameras=(small, small), given=small, noise_px=0.25)
    assert views[1].centre_mm == pytest.approx(RIGHT.centre_mm, rel=0.1)


NO_POSES = {
    "too near": ({"poses": (LEFT, look_at(50, -94.5, target_mm=(40, 0, 0)))}, "baseline_too_small"),
    "too far": ({"poses": (LEFT, look_at(50, 0, target_mm=(40, 0, 0)))}, "baseline_too_large"),
    "one place": ({"poses": (LEFT, LEFT)}, "same_photograph"),
    "camera of another shape": ({"given": replace(PHONE, height=675, cy=337.0)}, "camera_mismatch"),
    "corners of no board": ({"noise_px": 8.0}, "pose_unreliable"),
    "rolled-up paper": ({"bend_mm": (9.0, 0, 0)}, "pose_unreliable"),
}


@pytest.mark.parametrize(("arguments", "code"), NO_POSES.values(), ids=NO_POSES)
def test_views_that_tell_no_poses_are_refused(arguments, code):
    failure = outcome(**arguments)
    assert failure.code == code
    assert failure.advice


def test_photograph_from_behind_the_other_and_equal_pixels_are_refused():
    nearer, farther = look_at(target_mm=(40, 0, 0)), look_at(48, -94, distance_mm=450, target_mm=(40, 0, 0))
    failure = outcome(poses=(nearer, farther))  # by the angle of 3 degrees alone it would pass
    assert failure.code == "baseline_too_small"
    assert "distance" in failure.advice
    pair = PhotoPair(blank(PHONE), blank(PHONE))  # equal pixels
    failure = estimate_views(pair, (observed(PHONE, LEFT), observed(PHONE, RIGHT)), EstimateOptions(SPEC, PHONE))
    assert failure.code == "same_photograph"
