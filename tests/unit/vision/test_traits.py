import numpy as np
import pytest

from app.vision.model import MarkerSpec
from app.vision.traits import lab_of, sheet_white, traits_of

SPEC = MarkerSpec("plain", 9, 7, 11.0)


def grid(step_mm=1.0):
    """(200, 300, 3) points of the table plane, mm, x from -150, y from -100."""
    y, x = np.mgrid[0:200, 0:300]
    return np.dstack([x * step_mm - 150.0, y * step_mm - 100.0, np.zeros(x.shape)]).astype(np.float32)


def disc(points, centre, radius):
    return np.hypot(points[..., 0] - centre[0], points[..., 1] - centre[1]) < radius


def test_white_black_and_red_have_the_published_lab_values():
    found = lab_of(np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    assert found == pytest.approx(np.array([[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20]]), abs=0.02)


def test_disc_is_found_where_it_lies_and_as_large_as_it_is():
    points = grid()
    found = traits_of(disc(points, (60, 20), 25), points, np.full((200, 300, 3), 128, np.uint8), np.ones(3))
    assert found.centre_mm == pytest.approx((60, 20), abs=0.5)
    assert found.radius_mm == pytest.approx(25, abs=0.5)


def test_points_that_were_not_measured_do_not_count():
    points = grid()
    mask = disc(points, (60, 20), 25)
    points[::3] = np.nan
    assert traits_of(mask, points, np.zeros((200, 300, 3), np.uint8), np.ones(3)).centre_mm == pytest.approx(
        (60, 20), abs=1.5
    )


def test_region_without_points_has_a_colour_and_no_place():
    points = np.full((200, 300, 3), np.nan, np.float32)
    mask = disc(grid(), (0, 0), 30)
    found = traits_of(mask, points, np.full((200, 300, 3), 255, np.uint8), np.ones(3))
    assert (found.centre_mm, found.radius_mm) == (None, None)
    assert found.lab == pytest.approx((100, 0, 0), abs=0.1)


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.5, 0.8, 1.0), (0.6, 0.6, 0.6)])
def test_colour_is_the_same_in_another_light(light):
    """light: of the blue, green and red channel, linear."""
    points, share = grid(), np.array(light)
    linear = np.zeros((200, 300, 3)) + 0.05 * share
    linear[(np.abs(points[..., 0]) < 55) & (np.abs(points[..., 1]) < 44)] = 0.85 * share
    food = disc(points, (110, 0), 20)
    linear[food] = np.array([0.1, 0.2, 0.6]) * share
    pixels = np.rint(255 * (1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)).astype(np.uint8)
    white = sheet_white(SPEC, points, pixels, np.ones((200, 300), bool))
    expected = lab_of(np.array([0.6, 0.2, 0.1]) / 0.85)
    assert traits_of(food, points, pixels, white).lab == pytest.approx(expected, abs=1.0)


def test_sheet_that_is_not_seen_changes_no_colour():
    points = grid()
    pixels = np.full((200, 300, 3), 100, np.uint8)
    assert sheet_white(SPEC, points, pixels, np.zeros((200, 300), bool)).tolist() == [1, 1, 1]
