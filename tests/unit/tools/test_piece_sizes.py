"""The starter table's parts: sizes in words -> volumes, composition -> density."""

import math

import pytest

from tools.starter_table.piece_sizes import ML_PER_CUBIC_INCH, piece_volume_ml
from tools.starter_table.pore_free import pore_free_density


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


WATER, PROTEIN, FAT, CARBOHYDRATE, FIBER, ALCOHOL = "255", "203", "204", "205", "291", "221"


def food(**content):
    return {WATER: 0.0, PROTEIN: 0.0, FAT: 0.0, CARBOHYDRATE: 0.0} | content


def test_density_is_that_of_water_oil_and_milk_and_volumes_of_constituents_add_up():
    assert pore_free_density(food(**{WATER: 100.0})) == pytest.approx(0.998, rel=0.003)
    # Olive oil 0.911 to 0.916 at 20 C (Codex Alimentarius, CXS 33).
    assert pore_free_density(food(**{FAT: 100.0})) == pytest.approx(0.913, rel=0.01)
    # SR28, 01077; FAO/INFOODS gives 1.030 and 1.031.
    milk = {WATER: 88.13, PROTEIN: 3.15, FAT: 3.25, CARBOHYDRATE: 4.80}
    assert pore_free_density(milk) == pytest.approx(1.03, rel=0.01)
    half = pore_free_density(food(**{WATER: 50.0, FAT: 50.0}))
    water, oil = pore_free_density(food(**{WATER: 100.0})), pore_free_density(food(**{FAT: 100.0}))
    assert half == pytest.approx(1.0 / (0.5 / water + 0.5 / oil))
    all_fiber = pore_free_density(food(**{CARBOHYDRATE: 100.0, FIBER: 100.0}))
    assert all_fiber < pore_free_density(food(**{CARBOHYDRATE: 100.0}))
    assert pore_free_density(food(**{WATER: 95.0})) > pore_free_density(food(**{WATER: 100.0}))
    assert pore_free_density({PROTEIN: 3.0, FAT: 3.0, CARBOHYDRATE: 5.0}) is None
