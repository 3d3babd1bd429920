import cv2
import numpy as np
import pytest

from app.vision.views.patch_alignment import align_patches
from tests.unit.vision.views.test_disparity import texture

PLACES = np.array([[60.0, 60.0], [120.0, 90.0], [180.0, 120.0]])


def moved(image, matrix):
    return cv2.warpAffine(image, matrix, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def as_bytes(image):
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)


def found_from(first, second, start, jacobian=None):
    jacobians = np.broadcast_to(np.eye(2) if jacobian is None else jacobian, (len(PLACES), 2, 2))
    return align_patches(as_bytes(first), as_bytes(second), PLACES, start, jacobians, 4.0)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, -0.25), (1.37, -1.62)])
def test_shift_is_found_whatever_the_light(shift):
    first = texture()
    second = 0.7 * moved(first, np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])) + 20
    # A twentieth of a pixel: interpolation and 8 bits.
    assert np.allclose(found_from(first, second, PLACES), PLACES + shift, atol=0.05)


def test_guessed_jacobian_takes_a_large_turn_away():
    matrix = cv2.getRotationMatrix2D((120.0, 90.0), 40.0, 1.0)
    first = texture()
    truth = PLACES[1:2] @ matrix[:, :2].T + matrix[:, 2]
    start = PLACES @ matrix[:, :2].T + matrix[:, 2] + 0.5
    assert np.allclose(found_from(first, moved(first, matrix), start, matrix[:, :2])[1:2], truth, atol=0.08)


def test_patches_of_different_things_or_without_texture_give_nan_and_no_points_none():
    plain, image = np.full((180, 240), 90.0), as_bytes(texture())
    assert np.isnan(found_from(texture(seed=1), texture(seed=2), PLACES)).all()
    assert np.isnan(found_from(plain, plain, PLACES)).all()
    assert align_patches(image, image, np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)), 4.0).shape == (0, 2)
