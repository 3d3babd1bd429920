import numpy as np
import pytest

from app.vision.board.colour_space import LINEAR_OF_BYTE, decode_srgb, encode_srgb, lab_of


def test_white_black_and_red_have_the_published_lab_values():
    found = lab_of(np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    assert found == pytest.approx(np.array([[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20]]), abs=0.02)


def test_bytes_come_back_from_linear_light_and_light_outside_the_range_is_clipped():
    assert np.array_equal(np.rint(255 * encode_srgb(LINEAR_OF_BYTE)), np.arange(256))
    assert (LINEAR_OF_BYTE[0], LINEAR_OF_BYTE[255]) == (0.0, 1.0)
    assert LINEAR_OF_BYTE[128] == pytest.approx(0.2158605, abs=1e-7)  # IEC 61966-2-1
    for value in (0.04045, 0.04045 + 1e-9):  # where the curve's two pieces meet
        assert decode_srgb(np.array(value)) == pytest.approx(0.0031308, abs=1e-6)
    assert encode_srgb(np.array([-0.5, 0.0, 1.0, 7.0])) == pytest.approx(np.array([0.0, 0.0, 1.0, 1.0]), abs=1e-12)
