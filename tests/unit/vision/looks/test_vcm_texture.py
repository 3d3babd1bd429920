import math

import cv2
import numpy as np
import pytest

from app.vision.looks.vcm_texture import (
    GABOR_SCALES,
    GABOR_WAVELENGTH_PX,
    LEAST_STEP,
    PATTERNS,
    PERCENTILES,
    binary_patterns,
    color_patterns,
    gabor_energies,
    gradient_sizes,
)
from tests.unit.vision.food_regions import lopsided_mask, speckled

GREY = cv2.cvtColor(speckled(), cv2.COLOR_BGR2GRAY)
MASK = lopsided_mask()
ALL = np.ones((160, 160), bool)


def grating(wavelength_px: float, angle: float = 0.0) -> np.ndarray:
    rows, columns = np.mgrid[:160, :160]
    phase = 2.0 * np.pi * (columns * math.cos(angle) + rows * math.sin(angle)) / wavelength_px
    return np.round(127.0 + 100.0 * np.sin(phase)).astype(np.uint8)


def slow_patterns(picture: np.ndarray, mask: np.ndarray, radius: int) -> list[float]:
    """LBP(8, r), riu2, by its definition, a pixel at a time; the picture's edge goes on as it is."""

    def at(row: int, column: int) -> float:
        return float(picture[min(max(row, 0), picture.shape[0] - 1), min(max(column, 0), picture.shape[1] - 1)])

    counts = [0] * PATTERNS
    for row, column in zip(*np.nonzero(mask), strict=True):
        bits = []
        for number in range(8):
            angle = 2.0 * math.pi * number / 8
            y, x = round(row - radius * math.sin(angle), 9), round(column + radius * math.cos(angle), 9)
            y0, x0 = math.floor(y), math.floor(x)
            fy, fx = y - y0, x - x0
            value = (1 - fy) * ((1 - fx) * at(y0, x0) + fx * at(y0, x0 + 1))
            value += fy * ((1 - fx) * at(y0 + 1, x0) + fx * at(y0 + 1, x0 + 1))
            bits.append(value > at(row, column) + LEAST_STEP)
        changes = sum(bits[number] != bits[number - 1] for number in range(8))
        counts[sum(bits) if changes <= 2 else 9] += 1
    return [math.sqrt(count / sum(counts)) for count in counts]


def test_binary_patterns_are_those_of_a_slow_reference():
    picture = np.random.default_rng(5).integers(0, 256, (26, 22)).astype(np.uint8)
    mask = np.zeros(picture.shape, bool)
    mask[0:22, 4:21] = True
    fast = binary_patterns(picture, mask)
    for place, radius in enumerate((1, 2, 3)):
        part = fast[place * PATTERNS : (place + 1) * PATTERNS]
        assert part == pytest.approx(slow_patterns(picture, mask, radius), abs=0.03)  # float32 decides some ties


def test_binary_patterns_of_a_plain_surface_are_flat_and_of_dots_are_spots():
    flat = binary_patterns(np.full((160, 160), 90, np.uint8), MASK).reshape(6, PATTERNS)
    assert flat[:, 0] == pytest.approx(1.0)
    dots = np.full((160, 160), 90, np.uint8)
    dots[::8, ::8] = 200
    on_dots = np.zeros((160, 160), bool)
    on_dots[8:152:8, 8:152:8] = True
    assert binary_patterns(dots, on_dots).reshape(6, PATTERNS)[:3, 0] == pytest.approx(1.0)  # nothing brighter around
    assert binary_patterns(255 - dots, on_dots).reshape(6, PATTERNS)[:3, 8] == pytest.approx(1.0)  # all around


def test_colour_patterns_see_colour_and_not_lightness():
    lab = np.zeros((160, 160, 3), np.float32)
    plain = color_patterns(lab, MASK)
    lab[..., 0] = GREY
    assert color_patterns(lab, MASK).tolist() == plain.tolist()
    lab[..., 1] = GREY / 8.0
    of_a = color_patterns(lab, MASK)
    assert of_a[PATTERNS:].tolist() == plain[PATTERNS:].tolist()
    assert abs(of_a[0] - plain[0]) > 0.1


@pytest.mark.parametrize("angle", [0.0, math.pi / 6, 2 * math.pi / 3])
def test_grating_answers_most_at_the_scale_of_its_wavelength(angle):
    for place, scale in enumerate(GABOR_SCALES):
        energies = gabor_energies(grating(GABOR_WAVELENGTH_PX / scale, angle), ALL).reshape(3, 3)
        assert energies[:, 0].argmax() == place
        assert energies[place, 1] > 2.0  # one orientation of six answers more than all on average


def test_brightness_exposure_and_contrast_are_no_texture():
    halves = np.where(np.arange(160) < 80, 40, 220).astype(np.uint8) * np.ones((160, 1), np.uint8)
    away_from_the_edge = np.zeros((160, 160), bool)
    away_from_the_edge[:, :50] = away_from_the_edge[:, 110:] = True
    energies = gabor_energies(halves, away_from_the_edge).reshape(3, 3)
    assert (energies[:, 0] < math.log(2e-4)).all()  # 1e-4 stands for none
    without_direction = gabor_energies(GREY, ALL).reshape(3, 3)
    assert (without_direction[:, 1] < 1.3).all()
    assert (without_direction[:, 2] < 0.2).all()
    dim = np.round(GREY * 0.7 + 20.0).astype(np.uint8)
    assert gabor_energies(dim, MASK) == pytest.approx(gabor_energies(GREY, MASK), abs=0.08)  # 0.02 against noise


def test_gradients_of_a_ramp_are_its_slope():
    ramp = np.tile(np.arange(160, dtype=np.uint8), (160, 1))
    inner = np.zeros((160, 160), bool)
    inner[20:140, 20:140] = True
    sizes = gradient_sizes(ramp, inner)
    assert sizes[0] == pytest.approx(math.log1p(8.0), rel=1e-5)  # Sobel's weights add up to 8 a step
    assert sizes[1] == pytest.approx(0.0, abs=1e-5)
    assert sizes[2:] == pytest.approx([math.log1p(8.0)] * len(PERCENTILES), rel=1e-5)
