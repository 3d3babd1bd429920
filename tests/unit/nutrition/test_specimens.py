"""Specimens -> density: known truth, scaling, the floor that rounding sets."""

import math

import pytest

from app.nutrition.portion_density import Specimen, median_density


def specimens(*pairs):
    return [Specimen("", volume_ml, mass_g) for volume_ml, mass_g in pairs]


def test_density_is_the_median_with_a_spread_of_at_least_the_volumes_rounding():
    g_per_ml, sd = median_density(specimens((100, 80), (100, 90), (100, 130)), volume_step_ml=0.001)
    assert g_per_ml == pytest.approx(0.9)
    assert sd == pytest.approx(math.sqrt((0.2**2 + 0.1**2 + 0.3**2) / 2))
    g_per_ml, sd = median_density(specimens((100, 80), (100, 80)), volume_step_ml=10.0)
    assert (g_per_ml, sd) == (0.8, pytest.approx(0.8 * 10 / math.sqrt(12) / 100))
    once = median_density(specimens((100, 80), (150, 130)), volume_step_ml=1.0)
    twice = median_density(specimens((200, 80), (300, 130)), volume_step_ml=2.0)
    assert twice == pytest.approx([figure / 2 for figure in once])
    with pytest.raises(ValueError, match="a spread needs two"):
        median_density(specimens((100, 80)), volume_step_ml=1.0)


@pytest.mark.parametrize("pair", [(0, 80), (-1, 80), (100, 0), (math.nan, 80), (100, math.inf)])
def test_a_specimen_that_cannot_be_is_an_error(pair):
    with pytest.raises(ValueError, match="invalid specimen"):
        specimens(pair)
