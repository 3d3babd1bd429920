from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.vision.board.camera import camera_from_exif
from app.vision.board.pose import FOCAL_SPREAD_UNKNOWN, board_points, project
from app.vision.marker_spec import PlainBoard
from app.vision.model import MarkerObservation, Photo, View
from app.vision.views.focal_doubt import FLAG_SD, MOST_SD, doubt_focal
from app.vision.views.pose_doubt import volume_doubt
from app.vision.views.relative_pose import RefinedViews

SPEC = PlainBoard(9, 7, 11.0)
PHOTO = Photo(np.zeros((960, 1280, 3), np.uint8))  # without EXIF
GUESS = camera_from_exif(PHOTO)
NOISE_PX = 0.05
FOODS = np.array([[120.0, 0.0, 20.0]], np.float32)


def view(centre, forward, camera, seed):
    """A view of the board, its corners with the detector's noise. centre, forward: (3,) mm, table frame."""
    forward = np.asarray(forward, float) / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1e-3, 1.0] if abs(forward[2]) < 0.99 else [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.concatenate([cv2.Rodrigues(rotation)[0].ravel(), -rotation @ centre])
    corners = project(camera, board_points(SPEC), pose)
    corners = corners + np.random.default_rng(seed).normal(0.0, NOISE_PX, corners.shape)
    return View(PHOTO, camera, MarkerObservation(SPEC, corners), rotation, pose[3:], NOISE_PX)


def pair(where, focal_scale=0.75, source="board"):
    """Two views 60 mm apart: from straight above, as a rig over the table takes them, or from a slant."""
    camera = replace(GUESS, fx=GUESS.fx * focal_scale, fy=GUESS.fy * focal_scale, source=source)
    centres = np.array([[-30.0, -60.0, 350.0], [30.0, -60.0, 350.0]])
    if where == "slanted":
        centres = np.array([[-30.0, -300.0, 300.0], [30.0, -300.0, 300.0]])
    forwards = [[0.0, 0.0, -1.0]] * 2 if where == "above" else -centres
    return tuple(view(centres[k], forwards[k], camera, k) for k in (0, 1))


def test_board_from_straight_above_leaves_the_prior_of_the_focal_length_and_a_slanted_one_tells_it():
    above, slanted = (doubt_focal(*pair(where), GUESS) for where in ("above", "slanted"))
    assert above.log_sd == pytest.approx(FOCAL_SPREAD_UNKNOWN, rel=0.2)
    assert slanted.log_sd < 0.06  # half a step of the search and the corners' noise
    refined = [RefinedViews(*pair(where), np.zeros(3), 0) for where in ("above", "slanted")]
    assert volume_doubt(refined[0], FOODS, above).focal_sd > MOST_SD
    assert volume_doubt(refined[1], FOODS, slanted).focal_sd < 2 * FLAG_SD
    for source in ("given", "exif"):  # a known focal length leaves no such doubt
        assert doubt_focal(*pair("above", source=source), GUESS) is None
