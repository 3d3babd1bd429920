"""The table of a scene without a marker, against a rendered one whose plane is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.views.table_plane import RigPose, find_table_plane, table_from_plane
from tests.unit.vision.stereo_scene import BALL, blank_views, rendered_views, view_of

MAX_ANGLE_DEG, MAX_HEIGHT_MM = 0.5, 1.5  # the coarse match's 0.1 px over half the picture; the full pair refines it


def plane_of(left, right, up=None):
    rotation = right.rotation @ left.rotation.T
    pose = RigPose(rotation, right.translation_mm - rotation @ left.translation_mm)
    pictures = left.photo.pixels_bgr, right.photo.pixels_bgr
    return find_table_plane(pictures, (left.camera, right.camera), pose, np.random.default_rng(0), up)


@pytest.mark.parametrize("quarters", [0, 1, 2])
def test_table_under_a_ball_is_found_whichever_way_the_rig_is_held(quarters):
    left, right = (turned(view, quarters) for view in rendered_views(BALL))
    plane = plane_of(left, right)
    true_normal, true_distance = left.rotation[:, 2], left.centre_mm[2]
    assert np.degrees(np.arccos(plane[:3] @ true_normal)) < MAX_ANGLE_DEG
    assert abs(plane[3] - true_distance) < MAX_HEIGHT_MM


def turned(view, quarters):
    """The view of a camera that is turned by quarters of a turn: its picture turns clockwise."""
    pixels = np.ascontiguousarray(np.rot90(view.photo.pixels_bgr, -quarters))
    clockwise = np.linalg.matrix_power(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), quarters)
    camera = view.camera  # its principal point is the picture's middle
    if quarters % 2:
        camera = replace(camera, width=camera.height, height=camera.width, cx=camera.cy, cy=camera.cx)
    return view_of(pixels, (clockwise @ view.rotation, clockwise @ view.translation_mm), camera)


def test_photographs_that_show_nothing_have_no_table():
    failure = plane_of(*blank_views())
    assert failure.code == "table_not_found"
    assert failure.advice


def test_table_frame_lies_on_the_plane_and_a_plane_that_gravity_excludes_is_no_table():
    left, right = rendered_views(BALL)
    normal, plane = left.rotation[:, 2], plane_of(left, right)
    rotation, translation_mm = table_from_plane(plane)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    points = np.array([[0.0, 0.0, 0.0], [100.0, 50.0, 0.0], [0.0, 0.0, 30.0]]) @ rotation.T + translation_mm
    assert np.allclose(points @ plane[:3] + plane[3], [0.0, 0.0, 30.0], atol=1e-9)
    assert np.allclose(plane_of(left, right, up=normal), plane)
    tilt = cv2.Rodrigues(np.radians([25.0, 0.0, 0.0]))[0]
    assert plane_of(left, right, up=tilt @ normal).code == "table_not_found"
