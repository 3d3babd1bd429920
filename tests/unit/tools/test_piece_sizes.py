"""Sizes in words -> volumes."""

import math

import pytest

from tools.starter_table.piece_sizes import ML_PER_CUBIC_INCH, piece_volume_ml


@pytest.mark.parametrize(
    ("measure", "cubic_inches"),
    [
        ('slice (5" x 4" x 3/8")', 5 * 4 * 0.375),
        ('piece (2-1/2" x 2-3/4" x 1")', 2.5 * 2.75),
        ('slice (1 oz) (4" x 4" x 3/32" thick)', 16 * 3 / 32),
        ('patty, oval (approx 3" x 1-1/2" x 1/2")', 3 * 1.5 * 0.5),
        ('square, large (2-3/4" sq x 7/8")', 2.75**2 * 0.875),
        ('slice (4" dia x 1/8" thick)', math.pi * 4 * 0.125),
        ('small (2-3/4" dia x 2")', math.pi / 4 * 2.75**2 * 2),
        ("small 2-3/4 in. dia., 5/8 in. thick.", math.pi / 4 * 2.75**2 * 0.625),
    ],
)
def test_measure_with_a_full_size_gives_the_pieces_volume(measure, cubic_inches):
    assert piece_volume_ml(measure) == pytest.approx(ML_PER_CUBIC_INCH * cubic_inches)


@pytest.mark.parametrize(
    "measure",
    ['medium (3" dia)', 'slice (1/4" thick)', 'cup (1/2" pieces)', "cup, sliced", 'honeybun (4" x 3")', "oz"],
)
def test_measure_without_a_full_size_gives_none(measure):
    assert piece_volume_ml(measure) is None
