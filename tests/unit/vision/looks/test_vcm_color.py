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


def test_hue_of_a_grey_region_is_told_by_no_bin():
    roots = hue_saturation(Region(plain(GREY), ellipse_mask()), ellipse_mask())
    assert not roots[:18].any()
    assert roots[18:].tolist() == [1.0, *[0.0] * 7]


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
