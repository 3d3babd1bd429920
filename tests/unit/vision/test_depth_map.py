"""Depth maps: what is read of them, how noisy they say they are, and which files are refused by which code."""

import struct

import cv2
import numpy as np
import pytest

from app.core.errors import Failure, InvalidInputError
from app.vision.depth_camera import DepthCamera, depth_camera_from_mapping
from app.vision.depth_map import read_confidence, read_depth

CAMERA = DepthCamera(256, 192, 244.0, 244.0, 128.0, 96.0)


def slanted_mm(noise_share=0.0, blur_px=0.0):
    """A table from 400 to 600 mm, linear in inverse depth."""
    rows = np.linspace(1 / 600, 1 / 400, 192)[:, None]
    depth = 1.0 / np.repeat(rows, 256, axis=1)
    noise = np.random.default_rng(0).standard_normal(depth.shape)
    if blur_px:
        noise = cv2.GaussianBlur(noise, (0, 0), blur_px)
    return depth * (1 + noise_share * noise / noise.std())


def png(depth_mm, unit_mm=0.1):
    return cv2.imencode(".png", np.rint(depth_mm / unit_mm).astype(np.uint16))[1].tobytes()


def tiff(pixels):
    return cv2.imencode(".tiff", pixels, [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes()


def test_png_and_tiff_of_one_surface_are_alike():
    depth = slanted_mm()
    by_png, by_tiff = read_depth(png(depth), CAMERA), read_depth(tiff(depth.astype(np.float32)), CAMERA)
    np.testing.assert_allclose(by_png.depth_mm, depth, atol=0.051)  # half a unit
    np.testing.assert_allclose(by_tiff.depth_mm, depth, rtol=1e-6)


def test_unit_scales_the_whole_map():
    camera = DepthCamera(256, 192, 244.0, 244.0, 128.0, 96.0, unit_mm=1.0)
    np.testing.assert_allclose(read_depth(png(slanted_mm(), 1.0), camera).depth_mm, slanted_mm(), atol=0.51)


def test_zero_and_nan_are_no_measurement():
    depth = slanted_mm()
    depth[:50] = 0.0
    assert np.isnan(read_depth(png(depth), CAMERA).depth_mm[:50]).all()
    depth[:50] = np.nan
    seen = read_depth(tiff(depth.astype(np.float32)), CAMERA).depth_mm
    assert np.isnan(seen[:50]).all()
    assert np.isfinite(seen[50:]).all()


@pytest.mark.parametrize(("share", "blur_px"), [(0.01, 0.0), (0.02, 0.0), (0.01, 0.7)])
def test_noise_is_estimated_from_the_map(share, blur_px):
    depth = read_depth(tiff(slanted_mm(share, blur_px).astype(np.float32)), CAMERA)
    assert depth.sd_share == pytest.approx(share, rel=0.15)  # blocks of 256 px, the calmer half of them
    if blur_px:
        assert depth.error_area_px == pytest.approx(4 * np.pi * blur_px**2, rel=0.35)  # pixels sample it coarsely
    else:
        assert depth.error_area_px < 1.5


def code_of(data, camera=CAMERA):
    answer = read_depth(data, camera)
    assert isinstance(answer, Failure)
    return answer.code


def test_bad_files_are_refused_by_stable_codes():
    depth = slanted_mm()
    assert code_of(b"") == "depth_unreadable"
    assert code_of(b"\xff\xd8\xff\xe0 a photograph") == "depth_unreadable"
    assert code_of(png(depth)[:-200]) == "depth_unreadable"
    assert code_of(tiff(depth.astype(np.float32))[:3000]) == "depth_unreadable"
    assert code_of(cv2.imencode(".png", (depth / 4).astype(np.uint8))[1].tobytes()) == "depth_unreadable"
    assert code_of(cv2.imencode(".png", np.zeros((192, 256, 3), np.uint16))[1].tobytes()) == "depth_unreadable"
    assert code_of(png(depth[:100])) == "depth_mismatch"
    assert code_of(png(np.zeros_like(depth))) == "depth_empty"
    assert code_of(tiff(np.full((192, 256), np.nan, np.float32))) == "depth_empty"
    assert code_of(tiff(np.full((192, 256), 1e30, np.float32))) == "depth_empty"


def test_huge_map_is_refused_before_it_is_decoded():
    header = struct.pack(">IIBBBBB", 200_000, 200_000, 16, 0, 0, 0, 0)
    assert code_of(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header) == "depth_unreadable"


INTRINSICS = {"width": 256, "height": 192, "fx": 244.0, "fy": 244.0, "cx": 128.0, "cy": 96.0}


def test_depth_camera_is_a_camera_with_the_unit_of_its_maps():
    assert depth_camera_from_mapping(INTRINSICS) == CAMERA
    other = depth_camera_from_mapping(INTRINSICS | {"unit_mm": 1, "distortion": [0.1, 0.0, 0.0, 0.0, 0.0]})
    assert (other.unit_mm, other.distortion) == (1.0, (0.0,) * 5)
    assert np.array_equal(other.matrix, [[244.0, 0.0, 128.0], [0.0, 244.0, 96.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    "value",
    [
        {},
        {"width": 256},
        INTRINSICS | {"fx": -1.0},
        INTRINSICS | {"fx": 244.0 * 25},  # of the photograph
        INTRINSICS | {"cx": 300.0},
        INTRINSICS | {"width": 256.5},
        INTRINSICS | {"unit_mm": 0.0},
        INTRINSICS | {"unit_mm": 10**400},
        INTRINSICS | {"unit_mm": None},
        INTRINSICS | {"height": "192"},
    ],
)
def test_camera_that_cannot_be_is_refused(value):
    with pytest.raises(InvalidInputError) as refused:
        depth_camera_from_mapping(value)
    assert refused.value.code == "depth_camera_invalid"


def confidence(pixels):
    return cv2.imencode(".png", pixels)[1].tobytes()


@pytest.mark.parametrize(("low", "least", "high"), [(0, 1, 2), (127, 128, 255), (2, 200, 255)])
def test_depth_of_low_confidence_is_no_measurement(low, least, high):
    levels = np.full((192, 256), high, np.uint8)
    levels[:40], levels[40:80] = low, least
    seen = read_depth(png(slanted_mm()), CAMERA, confidence(levels)).depth_mm
    assert np.isnan(seen[:40]).all()
    assert np.array_equal(seen[40:], read_depth(png(slanted_mm()), CAMERA).depth_mm[40:])


def test_depth_that_is_nowhere_trusted_is_empty():
    failure = read_depth(png(slanted_mm()), CAMERA, confidence(np.zeros((192, 256), np.uint8)))
    assert failure.code == "depth_empty"


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (png(slanted_mm()), "depth_unreadable"),
        (b"no picture", "depth_unreadable"),
        (confidence(np.full((192, 256), 2, np.uint8))[:-20], "depth_unreadable"),
        (confidence(np.full((96, 128), 2, np.uint8)), "depth_mismatch"),
    ],
)
def test_bad_confidence_map_is_refused(content, code):
    failure = read_confidence(content, CAMERA)
    assert isinstance(failure, Failure)
    assert failure.code == code
