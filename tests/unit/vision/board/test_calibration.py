"""Intrinsics from photographs of a board: a known camera comes back."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.board.calibration import calibrate
from app.vision.intrinsics import Camera
from app.vision.marker_spec import parse_marker
from app.vision.model import Photo
from tests.unit.vision.synthetic import look_at, render_board

pytestmark = pytest.mark.slow  # six renderings; the gate calibrates in tests/integration/meals/upload

BOARD = parse_marker("plain:10x7:18")
CAMERA = Camera(800, 600, 650.0, 650.0, 393.0, 303.0, (0.08, -0.15, 5e-4, -5e-4, 0.0))
SLANTS = [(60, -90, 0), (50, 0, 20), (55, 120, -30), (80, -90, 90), (45, 60, 10), (50, -150, 45)]


@pytest.fixture(scope="module")
def photos() -> list[Photo]:
    aims = [(0, 0), (60, 30), (-60, -30), (40, -40), (-50, 40), (0, 0)]
    return [
        render_board(BOARD, CAMERA, look_at(*slant[:2], 300.0, slant[2], target_mm=(*aim, 0)))
        for slant, aim in zip(SLANTS, aims, strict=True)
    ]


def test_known_camera_comes_back(photos):
    result = calibrate([*photos, Photo(np.full((600, 800, 3), 128, np.uint8))], BOARD)
    camera = result.camera
    assert (camera.width, camera.height, camera.source) == (800, 600, "given")
    # Six views with 0.05 px of noise: 0.2 % of focal length, some px of principal point.
    assert (camera.fx, camera.fy) == (pytest.approx(650.0, rel=5e-3), pytest.approx(650.0, rel=5e-3))
    assert (camera.cx, camera.cy) == (pytest.approx(393.0, abs=4), pytest.approx(303.0, abs=4))
    assert camera.distortion[0] == pytest.approx(0.08, abs=0.04)
    assert result.rms_px < 0.15
    assert result.used == (0, 1, 2, 3, 4, 5)
    assert [photo.index for photo in result.rejected] == [6]


@pytest.mark.parametrize("chosen", [[], [0, 1], [0, 0, 0]], ids=["none", "two", "of one slant"])
def test_few_views_and_views_of_one_slant_are_too_few(photos, chosen):
    failure = calibrate([photos[number] for number in chosen], BOARD)
    assert failure.code == "calibration_views_insufficient"


def test_photograph_of_another_size_is_left_out(photos):
    turned = replace(photos[0], pixels_bgr=np.ascontiguousarray(np.rot90(photos[0].pixels_bgr)))
    result = calibrate([*photos[:4], turned], BOARD)
    assert [(photo.index, photo.failure.code) for photo in result.rejected] == [(4, "calibration_size_differs")]
