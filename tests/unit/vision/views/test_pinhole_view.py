"""A further view without distortion: points project where its photograph shows them."""

from dataclasses import replace

import numpy as np

from app.vision.model import Photo
from app.vision.views.pinhole_view import undistorted_view
from tests.unit.vision.stereo_scene import blank_views

POINTS = np.array([[40.0, -20.0, 0.0], [75.0, 10.0, 35.0], [90.0, -30.0, 12.0]])


def view_with(distortion=(0.0, 0.0, 0.0, 0.0, 0.0)):
    view = blank_views()[0]
    return replace(view, camera=replace(view.camera, distortion=distortion))


def test_view_at_its_own_focal_length_is_the_photograph():
    view = view_with()
    pixels = np.random.default_rng(0).integers(0, 255, view.photo.pixels_bgr.shape, np.uint8)
    pinhole = undistorted_view(replace(view, photo=Photo(pixels)), view.camera.fy)
    assert np.array_equal(pinhole.picture_bgr, pixels)
    assert undistorted_view(view, 10 * view.camera.fy).picture_bgr.shape == pixels.shape  # never enlarged


def test_point_is_drawn_where_it_projects():
    view = view_with((0.08, -0.1, 0.0, 0.0, 0.0))
    pinhole = undistorted_view(view, 700.0)
    in_camera = POINTS @ view.rotation.T + view.translation_mm
    x, y = (in_camera[:, :2] / in_camera[:, 2:]).T
    square = x * x + y * y
    factor = 1 + 0.08 * square - 0.1 * square**2  # OpenCV's radial model
    pixels = view.photo.pixels_bgr.copy()
    for column, row in np.column_stack([x * factor, y * factor]) * view.camera.fx + [view.camera.cx, view.camera.cy]:
        pixels[round(row) - 1 : round(row) + 2, round(column) - 1 : round(column) + 2] = 255
    drawn = undistorted_view(replace(view, photo=Photo(pixels)), 700.0).picture_bgr[..., 0]
    for column, row in pinhole.project(POINTS):
        left, top = int(column) - 6, int(row) - 6
        window = drawn[top : top + 13, left : left + 13].astype(float)
        rows, columns = np.indices(window.shape)
        middle = np.array([(columns * window).sum(), (rows * window).sum()]) / window.sum() + [left, top]
        assert np.abs(middle - [column, row]).max() < 0.8  # the dot was drawn on whole pixels of the larger photograph


def test_gradient_is_the_difference_of_projections():
    pinhole = undistorted_view(view_with(), 700.0)
    gradient, step = pinhole.pixel_gradient(POINTS), 1e-4
    for axis in range(3):
        moved = POINTS.copy()
        moved[:, axis] += step
        assert np.allclose(gradient[..., axis], (pinhole.project(moved) - pinhole.project(POINTS)) / step, atol=1e-3)
