"""Densities from composition."""

import pytest

from tools.starter_table.pore_free import pore_free_density

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
