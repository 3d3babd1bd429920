import cv2
import numpy as np
import pytest

from app.vision.board.colour_space import decode_srgb, lab_of
from app.vision.looks.vcm_color import LAB_RANGES, RINGS, hue_saturation, lab_histograms, lab_moments, lab_rings
from app.vision.looks.vcm_region import Region
from tests.unit.vision.food_regions import ellipse_mask, plain, speckled

RED, GREEN, GREY = (30, 20, 200), (40, 160, 60), (120, 120, 120)  # BGR


def lab_pixels(picture_bgr: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(picture_bgr.astype(np.float32) / 255.0, cv2.COLOR_BGR2LAB)


def lab_of_colour(colour_bgr: tuple[int, int, int]) -> np.ndarray:
    return lab_of(decode_srgb(np.array([colour_bgr[::-1]], np.float64) / 255.0))[0]


def target(radius: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    """A red middle, half as wide as all of it, with a green rim; and its mask."""
    rows, columns = np.mgrid[:160, :160]
    away = np.hypot(rows - 80, columns - 80)
    picture = np.where((away < radius / 2)[..., None], RED, GREEN).astype(np.uint8)
    return picture, away <= radius


def test_moments_of_one_colour_are_that_colour_without_spread():
    for colour in (RED, GREEN, GREY):
        moments = lab_moments(lab_pixels(plain(colour)).reshape(-1, 3))
        lab = lab_of_colour(colour)
        assert moments[:3] == pytest.approx(lab, abs=0.3)  # OpenCV interpolates CIELAB from a table
        assert moments[3:6] == pytest.approx(0.0, abs=0.03)  # sums of 25,600 in float32
        assert moments[6:21].reshape(3, 5) == pytest.approx(np.repeat(lab[:, None], 5, axis=1), abs=0.3)


def test_moments_are_those_of_a_slow_reference():
    pixels = np.random.default_rng(0).gamma(2.0, 10.0, (500, 3)).astype(np.float32)
    moments = lab_moments(pixels)
    for channel in range(3):
        values = [float(value) for value in pixels[:, channel]]
        mean = sum(values) / len(values)
        variance = sum((value - mean) ** 2 for value in values) / len(values)
        skewness = sum((value - mean) ** 3 for value in values) / len(values) / variance**1.5
        assert moments[[channel, 3 + channel, 21 + channel]] == pytest.approx([mean, variance**0.5, skewness], rel=1e-3)
        middle = sorted(values)
        assert moments[6 + 5 * channel + 2] == pytest.approx((middle[249] + middle[250]) / 2.0, rel=1e-5)


def test_each_histogram_of_lab_has_the_shares_of_its_pixels():
    pixels = lab_pixels(speckled()).reshape(-1, 3)
    roots, begins = lab_histograms(pixels), 0
    for channel, (low, high, bins) in enumerate(LAB_RANGES):
        part = roots[begins : begins + bins]
        assert (part**2).sum() == pytest.approx(1.0)
        place = np.clip(np.floor((pixels[:, channel].astype(float) - low) / (high - low) * bins), 0, bins - 1)
        assert part**2 == pytest.approx(np.bincount(place.astype(int), minlength=bins) / len(pixels), abs=1e-3)
        begins += bins
    assert begins == len(roots) == 60


def test_colours_beyond_the_range_count_to_the_outermost_bins():
    roots = lab_histograms(np.array([[120.0, 200.0, -300.0], [-3.0, -200.0, 300.0]], np.float32))
    assert np.flatnonzero(roots).tolist() == [0, 15, 16, 37, 38, 59]
    assert roots[roots > 0] ** 2 == pytest.approx(0.5)


def test_hue_of_a_grey_region_is_told_by_no_bin():
    roots = hue_saturation(Region(plain(GREY), ellipse_mask()), ellipse_mask())
    assert not roots[:18].any()
    assert roots[18:].tolist() == [1.0, *[0.0] * 7]


def test_hue_weighs_pixels_by_their_saturation():
    picture = plain((0, 0, 255))
    picture[80:] = (128, 255, 128)  # green, half as saturated
    roots = hue_saturation(Region(picture, np.ones((160, 160), bool)), np.ones((160, 160), bool))
    assert (roots[:18] ** 2)[[0, 6]] == pytest.approx([2 / 3, 1 / 3], abs=0.003)
    assert (roots[18:] ** 2).sum() == pytest.approx(1.0)


def test_rings_of_a_target_tell_its_rim_from_its_middle():
    picture, mask = target()
    rings = lab_rings(lab_pixels(picture), mask).reshape(len(RINGS), 2, 3)
    red, green = lab_of_colour(RED), lab_of_colour(GREEN)
    assert rings[0, 0] == pytest.approx(green, abs=0.5)
    assert rings[2, 0] == pytest.approx(red, abs=0.5)
    # of the ring from 1/3 to 2/3, the radii from 2/3 down to 1/2 are green, those from 1/2 to 1/3 red
    share = ((2 / 3) ** 2 - (1 / 2) ** 2) / ((2 / 3) ** 2 - (1 / 3) ** 2)
    assert rings[1, 0] == pytest.approx(share * green + (1 - share) * red, abs=4.0)
    assert rings[[0, 2], 1] == pytest.approx(0.0, abs=0.5)


def test_deepest_pixel_belongs_to_the_innermost_ring():
    picture, mask = plain(GREEN, 9), np.zeros((9, 9), bool)
    mask[3:6, 3:6] = True
    picture[4, 4] = RED
    rings = lab_rings(lab_pixels(picture), mask).reshape(3, 2, 3)
    assert rings[2, 0] == pytest.approx(lab_of_colour(RED), abs=0.5)
    assert rings[1, 0] == pytest.approx(lab_of_colour(GREEN), abs=0.5)
    assert rings[0, 1].max() > 10.0  # so thin that no pixel lies in the outermost third: all of it stands for it


def test_rings_begin_at_a_hole_and_at_the_photographs_edge():
    picture, mask = target()
    ring = mask & (np.hypot(*(np.mgrid[:160, :160] - 80)) > 31)
    green = lab_of_colour(GREEN)
    of_ring = lab_rings(lab_pixels(picture), ring).reshape(3, 2, 3)  # the hole's colour counts for nothing
    assert of_ring[:, 0] == pytest.approx(np.tile(green, (3, 1)), abs=0.5)
    of_all = lab_rings(lab_pixels(picture), np.ones(picture.shape[:2], bool)).reshape(3, 2, 3)
    assert of_all[0, 0] == pytest.approx(green, abs=0.5)
