"""The table of a scene without a marker, against a rendered one whose plane is known."""

import cv2
import numpy as np
import pytest

from app.core.errors import Failure
from app.vision.stereo.table_plane import RigPose, find_table_plane, table_from_plane
from tests.unit.vision.stereo_scene import Ball, blank_views, rendered_views

MAX_ANGLE_DEG, MAX_HEIGHT_MM = 0.5, 1.5  # the coarse match's 0.1 px over half the picture; the full pair refines it


def plane_of(left, right, up=None):
    rotation = right.rotation @ left.rotation.T
    pose = RigPose(rotation, right.translation_mm - rotation @ left.translation_mm)
    pictures = left.photo.pixels_bgr, right.photo.pixels_bgr
    return find_table_plane(pictures, (left.camera, right.camera), pose, np.random.default_rng(0), up)


@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 180.0])
def test_table_under_a_ball_is_found_whichever_way_the_rig_is_held(roll_deg):
    left, right = rendered_views(Ball((115.0, 15.0), 33.0), roll_deg)
    plane = plane_of(left, right)
    true_normal, true_distance = left.rotation[:, 2], left.centre_mm[2]
    assert np.degrees(np.arccos(plane[:3] @ true_normal)) < MAX_ANGLE_DEG
    assert abs(plane[3] - true_distance) < MAX_HEIGHT_MM


def test_table_frame_lies_on_the_plane_with_its_normal_upwards():
    left, right = rendered_views(None)
    plane = plane_of(left, right)
    rotation, translation_mm = table_from_plane(plane)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0
    points = np.array([[0.0, 0.0, 0.0], [100.0, 50.0, 0.0], [0.0, 0.0, 30.0]]) @ rotation.T + translation_mm
    assert np.allclose(points @ plane[:3] + plane[3], [0.0, 0.0, 30.0], atol=1e-9)


def test_photographs_that_show_nothing_have_no_table():
    failure = plane_of(*blank_views())
    assert isinstance(failure, Failure)
    assert failure.code == "table_not_found"
    assert failure.advice


def test_plane_that_gravity_excludes_is_no_table():
    left, right = rendered_views(Ball((115.0, 15.0), 33.0))
    normal = left.rotation[:, 2]
    found = plane_of(left, right, up=normal)
    assert np.allclose(found, plane_of(left, right))
    tilt = cv2.Rodrigues(np.radians([25.0, 0.0, 0.0]))[0]
    assert plane_of(left, right, up=tilt @ normal).code == "table_not_found"
