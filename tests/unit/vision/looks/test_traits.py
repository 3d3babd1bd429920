import numpy as np
import pytest

from app.vision.board.colour_space import encode_srgb, lab_of
from app.vision.looks.traits import traits_of
from app.vision.model import ColourCorrection

AS_TAKEN = ColourCorrection(np.eye(3), "none")


def grid(step_mm=1.0):
    """(200, 300, 3) points of the table plane, mm, x from -150, y from -100."""
    y, x = np.mgrid[0:200, 0:300]
    return np.dstack([x * step_mm - 150.0, y * step_mm - 100.0, np.zeros(x.shape)]).astype(np.float32)


def disc(points, centre, radius):
    return np.hypot(points[..., 0] - centre[0], points[..., 1] - centre[1]) < radius


def test_disc_is_found_where_it_lies_and_as_large_as_it_is():
    points = grid()
    found = traits_of(disc(points, (60, 20), 25), points, np.full((200, 300, 3), 128, np.uint8), AS_TAKEN)
    assert found.centre_mm == pytest.approx((60, 20), abs=0.5)
    assert found.radius_mm == pytest.approx(25, abs=0.5)
    mask = disc(points, (60, 20), 25)
    points[::3] = np.nan  # what was not measured does not count
    again = traits_of(mask, points, np.zeros((200, 300, 3), np.uint8), AS_TAKEN)
    assert again.centre_mm == pytest.approx((60, 20), abs=1.5)


def test_region_without_points_has_a_colour_and_no_place():
    points = np.full((200, 300, 3), np.nan, np.float32)
    mask = disc(grid(), (0, 0), 30)
    found = traits_of(mask, points, np.full((200, 300, 3), 255, np.uint8), AS_TAKEN)
    assert (found.centre_mm, found.radius_mm) == (None, None)
    assert found.lab == pytest.approx((100, 0, 0), abs=0.1)


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.5, 0.8, 1.0), (0.6, 0.6, 0.6)])
def test_colour_is_the_same_in_another_light(light):
    """light: of the red, green and blue channel, linear."""
    linear = np.array([0.6, 0.2, 0.1])
    pixels = np.full((200, 300, 3), np.rint(255 * encode_srgb(linear * light))[::-1], np.uint8)
    found = traits_of(
        disc(grid(), (60, 0), 20), grid(), pixels, ColourCorrection(np.diag(1 / np.array(light)), "white")
    )
    assert found.lab == pytest.approx(lab_of(linear), abs=1.0)  # bytes, twice
