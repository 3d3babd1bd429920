import cv2
import numpy as np
import pytest

from app.vision.views.point_following import evenly_lit, follow_points
from tests.unit.vision.views.test_disparity import texture

PLACES = np.array([[60.0, 60.0], [120.0, 90.0], [180.0, 120.0]])


def even(image):
    return evenly_lit(np.clip(image + 0.5, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, -0.25), (2.37, -1.62)])
def test_points_are_followed_to_where_they_are_whatever_the_light(shift):
    first = texture()
    moved = cv2.warpAffine(
        first, np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]]), first.shape[::-1], flags=cv2.INTER_CUBIC
    )
    at, followed = follow_points(even(first), even(0.7 * moved + 20), PLACES, PLACES)
    assert np.array_equal(at, PLACES)
    assert np.allclose(followed, PLACES + shift, atol=0.06)  # interpolation by 32nds of a pixel


def test_what_is_not_there_or_has_no_texture_is_not_followed():
    plain = np.full((180, 240), 90.0)
    assert len(follow_points(even(texture(seed=1)), even(texture(seed=2)), PLACES, PLACES)[0]) == 0
    assert len(follow_points(even(plain), even(plain), PLACES, PLACES)[0]) == 0
    assert follow_points(even(plain), even(plain), np.empty((0, 2)), np.empty((0, 2)))[1].shape == (0, 2)
