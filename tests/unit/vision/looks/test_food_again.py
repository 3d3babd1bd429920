"""A food found again in a photograph in which nothing of the first one can be matched."""

import cv2
import numpy as np
import pytest

from app.vision.looks.food_again import find_again
from app.vision.looks.vcm_region import Region
from app.vision.model import Photo

SIZE = (480, 640)


def speckled(colour_bgr, seed):
    """(480, 640, 3) a surface of a colour with specks."""
    rng = np.random.default_rng(seed)
    grain = cv2.resize(rng.normal(0, 14, (120, 160)), SIZE[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(np.array(colour_bgr) + grain[..., None], 0, 255).astype(np.uint8)


def disc(middle, half, size=SIZE):
    mask = np.zeros(size, np.uint8)
    cv2.ellipse(mask, middle, half, 0, 0, 360, 1, -1)
    return mask > 0


RED, GREEN, GREY = speckled((40, 50, 200), 1), speckled((60, 170, 90), 2), speckled((150, 150, 150), 3)


def picture(*foods):
    pixels = GREY.copy()
    for surface, mask in foods:
        pixels[mask] = surface[mask]
    return Photo(cv2.GaussianBlur(pixels, (0, 0), 1.0))


def food(surface):
    """The food from above, in another size and place."""
    mask = disc((64, 64), (50, 50), (128, 128))
    pixels = cv2.resize(GREY, (128, 128))
    pixels[mask] = cv2.resize(surface, (128, 128))[mask]
    return Region(pixels, mask)


def test_each_food_is_found_in_its_place_with_its_outline():
    high, flat = disc((180, 240), (70, 80)), disc((450, 260), (90, 45))
    both = picture((RED, high), (GREEN, flat))
    red, green = find_again([food(RED), food(GREEN)], [False, False], both)
    for again, shown in ((red, high), (green, flat)):
        area = np.count_nonzero(again.mask) / again.scale**2
        assert area == pytest.approx(np.count_nonzero(shown), rel=0.1)
        _, _, wide, high_px = cv2.boundingRect(again.mask.astype(np.uint8))
        rows, columns = np.nonzero(shown)
        assert wide / high_px == pytest.approx(np.ptp(columns) / np.ptp(rows), rel=0.08)


def test_one_piece_is_one_food_of_which_the_pointed_one_chooses_first():
    one = picture((RED, disc((320, 240), (80, 70))))
    assert [again is not None for again in find_again([food(RED), food(RED)], [False, True], one)] == [False, True]


def test_nothing_is_found_where_nothing_is():
    assert find_again([food(RED), None], [True, False], Photo(np.full((*SIZE, 3), 128, np.uint8))) == [None, None]
    assert find_again([], [], picture()) == []
