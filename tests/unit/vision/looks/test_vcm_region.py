import math

import cv2
import numpy as np
import pytest

from app.vision.looks.vcm_region import MARGIN, SIDE_PX, region_of_box, region_of_rings
from tests.unit.vision.food_regions import plain, speckled

HUGE = 1e12


def square(low: float, high: float) -> np.ndarray:
    return np.array([[low, low], [high, low], [high, high], [low, high]], np.float64)


def circle(x: float, y: float, radius: float, corners: int = 90) -> np.ndarray:
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1)


def disc_on_a_ground(side: int, x: float, y: float, radius: float) -> np.ndarray:
    """A red disc on a grey ground, both with a little noise."""
    rows, columns = np.mgrid[:side, :side]
    picture = np.where((np.hypot(columns - x, rows - y) <= radius)[..., None], (40, 40, 190), (150, 150, 150))
    noise = np.random.default_rng(0).normal(0.0, 4.0, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def inside_by_crossings(rings: list[np.ndarray], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The even-odd rule by its definition: edges crossed by a ray to the right."""
    crossed = np.zeros(x.shape, int)
    for ring in rings:
        for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            if ay != by:
                crossed += ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return crossed % 2 == 1


def test_mask_of_rings_is_that_of_the_even_odd_rule_with_its_hole():
    photo = speckled(300)
    star = circle(150, 140, 1.0, corners=14)
    star = (star - (150, 140)) * np.where(np.arange(14) % 2, 60.0, 110.0)[:, None] + (150, 140)
    rings = [star, circle(150, 140, 25)]
    region = region_of_rings(photo, rings)
    low, high = star.min(axis=0), star.max(axis=0)
    scale = SIDE_PX / (high - low).max()
    origin = np.maximum(0.0, np.floor(low - MARGIN * (high - low)))
    rows, columns = np.mgrid[: region.mask.shape[0], : region.mask.shape[1]]
    truth = inside_by_crossings(rings, columns / scale + origin[0], rows / scale + origin[1])
    assert overlap(region.mask, truth) > 0.94  # OpenCV draws the outline's own pixels too
    assert not region.mask[round((140 - origin[1]) * scale), round((150 - origin[0]) * scale)]


def test_rings_of_less_than_three_corners_bound_nothing_and_pictures_without_colour_raise():
    photo = speckled(100)
    for rings in ([], [np.zeros((0, 2))], [np.array([[9.0, 9], [60, 60]])]):
        assert region_of_rings(photo, rings) is None
    alone = region_of_rings(photo, [square(20, 60)])
    beside = region_of_rings(photo, [square(20, 60), np.array([[9.0, 9], [90, 90]])])
    assert np.array_equal(alone.mask, beside.mask)
    for picture in (photo[..., 0], np.zeros((9, 9, 4), np.uint8), photo.astype(np.float32)):
        with pytest.raises(ValueError, match="uint8"):
            region_of_rings(picture, [square(1, 8)])
        with pytest.raises(ValueError, match="uint8"):
            region_of_box(picture, (1, 1, 7, 7))


AROUND_THE_CORNER = np.array([[-50.0, 20.0], [-50, -50], [20, -50]])  # its box is in view, nothing of it is


@pytest.mark.parametrize("ring", [square(-60, -20), square(100, 160), square(-1.0, 0.4), AROUND_THE_CORNER])
def test_outline_outside_the_photograph_gives_no_region(ring):
    assert region_of_rings(speckled(100), [ring]) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_corner_that_is_no_number_gives_no_region(bad):
    ring = square(20, 60)
    ring[2, 1] = bad
    assert region_of_rings(speckled(100), [ring]) is None


@pytest.mark.parametrize(
    ("side", "radius", "box"),
    [(120, 30, (27, 27, 66, 66)), (1500, 300, (370, 170, 660, 660)), (400, 50, (95, 125, 160, 170))],
    ids=["small", "large", "off the middle of its box"],
)
def test_disc_on_a_plain_ground_is_found_in_its_box(side, radius, box):
    x, y = {120: (60, 60), 1500: (700, 500), 400: (150, 180)}[side]
    region = region_of_box(disc_on_a_ground(side, x, y, radius), box)
    truth = cv2.inRange(region.pixels_bgr, (0, 0, 150), (95, 95, 255)) > 0
    assert overlap(region.mask, truth) > 0.9


def test_nothing_that_stands_out_gives_an_ellipse_in_the_box():
    region = region_of_box(plain((90, 120, 150), 200), (50, 60, 100, 80))
    assert abs(np.count_nonzero(region.mask) / (np.pi / 4 * SIDE_PX * SIDE_PX * 0.8) - 1.0) < 0.05


EMPTY = [(10, 10, 0, 0), (10, 10, -5, 20), (10, 10, 0.5, 0.5), (-50, 0, 40, 40), (100, 0, 40, 40), (-99.5, 0, 100, 50)]
NOWHERE = [(math.nan, 0, 9, 9), (-math.inf, 0, math.inf, 9), (HUGE, HUGE, HUGE, HUGE)]


@pytest.mark.parametrize("box", EMPTY + NOWHERE)
def test_box_that_shows_nothing_gives_no_region(box):
    assert region_of_box(speckled(100), box) is None


@pytest.mark.parametrize("box", [(99, 99, 900, 900), (-990, 40, 1000, 3), (0, 0, 1e308, 1e308)])
def test_sliver_in_view_of_a_large_box_stays_small(box):
    region = region_of_box(speckled(100), box)
    assert region.mask.any()
    assert max(region.mask.shape) <= 3 * SIDE_PX
    assert (region.mask.shape == (SIDE_PX, SIDE_PX)) == (box[0] == 0)  # that around the whole photograph is square
