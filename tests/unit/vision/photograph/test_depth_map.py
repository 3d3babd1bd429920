"""Depth maps: what is read of them, how noisy they say they are, and which files are refused by which code."""

import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.core.errors import InvalidInputError
from app.vision.photograph.depth_camera import DepthCamera, depth_camera_from_mapping
from app.vision.photograph.depth_map import read_confidence, read_depth

CAMERA = DepthCamera(256, 192, 244.0, 244.0, 128.0, 96.0)


def slanted_mm(noise_share=0.0, blur_px=0.0):
    """A table from 400 to 600 mm, linear in inverse depth."""
    rows = np.linspace(1 / 600, 1 / 400, 192)[:, None]
    depth = 1.0 / np.repeat(rows, 256, axis=1)
    noise = np.random.default_rng(0).standard_normal(depth.shape)
    if blur_px:
        noise = cv2.GaussianBlur(noise, (0, 0), blur_px)
    return depth * (1 + noise_share * noise / noise.std())


def encoded(pixels):
    return cv2.imencode(".png", pixels)[1].tobytes()


def png(depth_mm, unit_mm=0.1):
    return encoded(np.rint(depth_mm / unit_mm).astype(np.uint16))


def tiff(pixels):
    return cv2.imencode(".tiff", pixels, [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes()


def test_png_and_tiff_of_one_surface_are_alike():
    depth = slanted_mm()
    by_png, by_tiff = read_depth(png(depth), CAMERA), read_depth(tiff(depth.astype(np.float32)), CAMERA)
    np.testing.assert_allclose(by_png.depth_mm, depth, atol=0.051)  # half a unit
    np.testing.assert_allclose(by_tiff.depth_mm, depth, rtol=1e-6)
    in_mm = replace(CAMERA, unit_mm=1.0)
    np.testing.assert_allclose(read_depth(png(depth, 1.0), in_mm).depth_mm, depth, atol=0.51)


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


SLANTED = slanted_mm()
HUGE = struct.pack(">I4sIIBBBBB", 13, b"IHDR", 200_000, 200_000, 16, 0, 0, 0, 0)


UNREADABLE = [
    b"",
    b"\xff\xd8\xff\xe0 a photograph",
    png(SLANTED)[:-200],
    tiff(SLANTED.astype(np.float32))[:3000],
    encoded((SLANTED / 4).astype(np.uint8)),
    encoded(np.zeros((192, 256, 3), np.uint16)),
    b"\x89PNG\r\n\x1a\n" + HUGE,  # before it is decoded
]
EMPTY = [png(np.zeros_like(SLANTED)), *(tiff(np.full((192, 256), value, np.float32)) for value in (np.nan, 1e30))]


def test_bad_files_are_refused_by_stable_codes():
    assert {read_depth(data, CAMERA).code for data in UNREADABLE} == {"depth_unreadable"}
    assert {read_depth(data, CAMERA).code for data in EMPTY} == {"depth_empty"}
    assert read_depth(png(SLANTED[:100]), CAMERA).code == "depth_mismatch"


INTRINSICS = {"width": 256, "height": 192, "fx": 244.0, "fy": 244.0, "cx": 128.0, "cy": 96.0}


def test_depth_camera_is_a_camera_with_the_unit_of_its_maps():
    assert depth_camera_from_mapping(INTRINSICS) == CAMERA
    other = depth_camera_from_mapping(INTRINSICS | {"unit_mm": 1, "distortion": [0.1, 0.0, 0.0, 0.0, 0.0]})
    assert (other.unit_mm, other.distortion) == (1.0, (0.0,) * 5)
    assert np.array_equal(other.matrix, [[244.0, 0.0, 128.0], [0.0, 244.0, 96.0], [0.0, 0.0, 1.0]])


OUT_OF_RANGE = [{"fx": -1.0}, {"fx": 244.0 * 25}, {"cx": 300.0}, {"unit_mm": 0.0}, {"unit_mm": 10**400}]
NO_NUMBERS = [{"width": 256.5}, {"unit_mm": None}, {"height": "192"}]


@pytest.mark.parametrize("value", [{}, {"width": 256}, *(INTRINSICS | each for each in OUT_OF_RANGE + NO_NUMBERS)])
def test_camera_that_cannot_be_is_refused(value):
    with pytest.raises(InvalidInputError) as refused:
        depth_camera_from_mapping(value)
    assert refused.value.code == "depth_camera_invalid"


@pytest.mark.parametrize(("low", "least", "high"), [(0, 1, 2), (127, 128, 255), (2, 200, 255)])
def test_depth_of_low_confidence_is_no_measurement(low, least, high):
    levels = np.full((192, 256), high, np.uint8)
    levels[:40], levels[40:80] = low, least
    seen = read_depth(png(slanted_mm()), CAMERA, encoded(levels)).depth_mm
    assert np.isnan(seen[:40]).all()
    assert np.array_equal(seen[40:], read_depth(png(slanted_mm()), CAMERA).depth_mm[40:])
    nowhere_trusted = encoded(np.zeros((192, 256), np.uint8))
    assert read_depth(png(slanted_mm()), CAMERA, nowhere_trusted).code == "depth_empty"


def test_bad_confidence_map_is_refused():
    whole = encoded(np.full((192, 256), 2, np.uint8))
    for content in (png(slanted_mm()), b"no picture", whole[:-20]):
        assert read_confidence(content, CAMERA).code == "depth_unreadable"
    assert read_confidence(encoded(np.full((96, 128), 2, np.uint8)), CAMERA).code == "depth_mismatch"
