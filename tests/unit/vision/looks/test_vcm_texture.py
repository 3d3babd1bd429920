import math

import numpy as np
import pytest

from app.vision.looks.vcm_texture import (
    GABOR_SCALES,
    GABOR_WAVELENGTH_PX,
    LEAST_STEP,
    PATTERNS,
    PERCENTILES,
    binary_patterns,
    gabor_energies,
    gradient_sizes,
)

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


@pytest.mark.parametrize("angle", [0.0, math.pi / 6, 2 * math.pi / 3])
def test_grating_answers_most_at_the_scale_of_its_wavelength(angle):
    for place, scale in enumerate(GABOR_SCALES):
        energies = gabor_energies(grating(GABOR_WAVELENGTH_PX / scale, angle), ALL).reshape(3, 3)
        assert energies[:, 0].argmax() == place
        assert energies[place, 1] > 2.0  # one orientation of six answers more than all on average


def test_gradients_of_a_ramp_are_its_slope():
    ramp = np.tile(np.arange(160, dtype=np.uint8), (160, 1))
    inner = np.zeros((160, 160), bool)
    inner[20:140, 20:140] = True
    sizes = gradient_sizes(ramp, inner)
    assert sizes[0] == pytest.approx(math.log1p(8.0), rel=1e-5)  # Sobel's weights add up to 8 a step
    assert sizes[1] == pytest.approx(0.0, abs=1e-5)
    assert sizes[2:] == pytest.approx([math.log1p(8.0)] * len(PERCENTILES), rel=1e-5)
