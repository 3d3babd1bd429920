"""Densities from composition."""

import pytest

from tools.starter_table.pore_free import pore_free_density

WATER, PROTEIN, FAT, CARBOHYDRATE, FIBER, ALCOHOL = "255", "203", "204", "205", "291", "221"


def food(**content):
    return {WATER: 0.0, PROTEIN: 0.0, FAT: 0.0, CARBOHYDRATE: 0.0} | content


def test_water_is_as_dense_as_water():
    assert pore_free_density(food(**{WATER: 100.0})) == pytest.approx(0.998, rel=0.003)


def test_oil_is_as_dense_as_oil():
    # Olive oil 0.911 to 0.916 at 20 C (Codex Alimentarius, CXS 33).
    assert pore_free_density(food(**{FAT: 100.0})) == pytest.approx(0.913, rel=0.01)


def test_whole_milk_is_as_dense_as_measured():
    # SR28, 01077; FAO/INFOODS gives 1.030 and 1.031.
    milk = {WATER: 88.13, PROTEIN: 3.15, FAT: 3.25, CARBOHYDRATE: 4.80}
    assert pore_free_density(milk) == pytest.approx(1.03, rel=0.01)


def test_volumes_of_constituents_add_up():
    half = pore_free_density(food(**{WATER: 50.0, FAT: 50.0}))
    water, oil = pore_free_density(food(**{WATER: 100.0})), pore_free_density(food(**{FAT: 100.0}))
    assert half == pytest.approx(1.0 / (0.5 / water + 0.5 / oil))


def test_fibre_is_taken_out_of_the_carbohydrate():
    all_fiber = pore_free_density(food(**{CARBOHYDRATE: 100.0, FIBER: 100.0}))
    assert all_fiber < pore_free_density(food(**{CARBOHYDRATE: 100.0}))


def test_what_is_left_of_a_hundred_grams_is_ash():
    assert pore_free_density(food(**{WATER: 95.0})) > pore_free_density(food(**{WATER: 100.0}))


def test_unknown_water_gives_none():
    assert pore_free_density({PROTEIN: 3.0, FAT: 3.0, CARBOHYDRATE: 5.0}) is None
