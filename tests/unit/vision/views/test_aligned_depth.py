"""Depth maps that share their photograph's pixels: intrinsics, lens, and the scale that the marker's table gives."""

from dataclasses import replace

import numpy as np
import pytest

from app.vision.geometry.projective import homogeneous
from app.vision.model import DepthMap
from app.vision.views.aligned_depth import depth_in_view, follow_camera
from app.vision.views.features import undistort_to_rays
from tests.unit.vision.stereo_scene import BALL, CAMERA, blank_views, true_depth

SIZE = (200, 150)
VIEW = blank_views()[0]
PER_PX = CAMERA.width / SIZE[0]
FOCAL, CENTRE = CAMERA.fx / PER_PX, tuple((side - 1) / 2 for side in SIZE)
TRUE_MM = true_depth(VIEW.rotation, VIEW.centre_mm, FOCAL, CENTRE, SIZE[::-1], BALL)


def relative(scale=0.62, offset=-0.4e-3, noise=0.0, seed=0):
    """Scale and offset in the inverse depth, which is some 2e-3 / mm; noise: a share of it."""
    inverse = scale / TRUE_MM + offset
    inverse = inverse * (1 + noise * np.random.default_rng(seed).standard_normal(inverse.shape))
    depth = (1 / inverse).astype(np.float32)
    return DepthMap(depth, 1.0, 1.0, 0.0, 0.0, max(noise, 1e-3), 1.0, is_aligned=True, is_relative=True)


def metric():
    return replace(relative(1.0, 0.0), is_relative=False)


def test_aligned_map_takes_the_cameras_intrinsics():
    depth = follow_camera(metric(), CAMERA)
    assert depth.fx == pytest.approx(FOCAL)
    assert (depth.cx, depth.cy) == pytest.approx(CENTRE)
    assert not depth.is_aligned
    assert np.array_equal(depth.depth_mm, metric().depth_mm)
    own = replace(metric(), is_aligned=False)  # of a pinhole of its own
    assert follow_camera(own, CAMERA) is own


def test_lens_is_taken_out():
    camera = replace(CAMERA, distortion=(0.15, 0.0, 0.0, 0.0, 0.0))
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    pixels = (np.stack([columns, rows], -1).reshape(-1, 2) + 0.5) * PER_PX - 0.5
    rays = undistort_to_rays(replace(VIEW, camera=camera), pixels)
    table = (-VIEW.centre_mm[2] / (homogeneous(rays) @ VIEW.rotation)[:, 2]).reshape(SIZE[::-1])
    seen = follow_camera(replace(metric(), depth_mm=table.astype(np.float32)), camera).depth_mm
    flat = true_depth(VIEW.rotation, VIEW.centre_mm, FOCAL, CENTRE, SIZE[::-1], None)
    inside = np.isfinite(seen)
    assert inside.mean() > 0.9
    np.testing.assert_allclose(seen[inside], flat[inside], rtol=0.004)  # nearest pixel
    assert np.abs(table / flat - 1).max() > 0.01  # as it would be with the lens left in


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (0.62, -0.4e-3), (3.0, 5e-3)])
def test_relative_map_is_made_metric_whatever_its_scale_and_offset(scale, offset):
    depth = depth_in_view(relative(scale, offset), VIEW)
    np.testing.assert_allclose(depth.depth_mm, TRUE_MM, rtol=0.003)  # the ball's foot is near the table
    assert not depth.is_relative


def test_noise_of_a_relative_map_becomes_that_of_its_depth():
    shown = relative(0.62, -0.4e-3, noise=0.01)
    depth = depth_in_view(shown, VIEW)
    assert np.nanmedian(np.abs(depth.depth_mm / TRUE_MM - 1)) < 0.02
    truly = np.nanstd(((1 / depth.depth_mm) * TRUE_MM)[TRUE_MM > 0] - 1)
    assert depth.sd_share == pytest.approx(truly, rel=0.3)
    assert abs(np.nanmedian(depth.depth_mm / TRUE_MM) - 1) < 0.005


def test_maps_that_grow_with_depth_of_chance_or_without_a_marker_are_left_out():
    assert depth_in_view(relative(-0.3, 5e-3), VIEW) is None
    noise = np.random.default_rng(1).uniform(400.0, 800.0, TRUE_MM.shape).astype(np.float32)
    assert depth_in_view(replace(relative(), depth_mm=noise), VIEW) is None
    assert depth_in_view(relative(), replace(VIEW, marker=None)) is None
