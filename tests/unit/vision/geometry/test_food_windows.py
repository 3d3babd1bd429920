"""Pictures and masks that are worked on within a window are there what the whole ones are."""

import cv2
import numpy as np

from app.vision.geometry.masks import inward_px
from app.vision.geometry.pictures import LabPicture, lab_of
from app.vision.views.reconstruction import plane_points
from app.vision.views.rectification import rectify_by_poses
from tests.unit.vision.stereo_scene import blank_views

WINDOW = (slice(37, 90), slice(21, 131))


def test_lab_within_a_window_is_that_of_the_whole_picture():
    image = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    picture = LabPicture(image)
    assert np.array_equal(picture.within(WINDOW)[WINDOW], lab_of(image)[WINDOW])
    assert picture.shape == (120, 160)
    other = (slice(0, 20), slice(0, 10))
    both = picture.within(other)
    assert np.array_equal(both[other], lab_of(image)[other])
    assert np.array_equal(both[WINDOW], lab_of(image)[WINDOW])


def test_distance_inward_is_that_of_the_whole_picture():
    mask = np.zeros((120, 160), np.bool_)
    mask[40:85, 30:120], mask[60:64, 50:54] = True, False
    whole = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    assert np.array_equal(inward_px(mask), whole)
    assert not inward_px(np.zeros_like(mask)).any()


def test_points_of_the_plane_within_a_window_are_those_of_the_whole_grid():
    pair = rectify_by_poses(*blank_views())
    assert np.array_equal(plane_points(pair, WINDOW), plane_points(pair)[WINDOW], equal_nan=True)
