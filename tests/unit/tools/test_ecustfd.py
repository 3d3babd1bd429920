"""Measured densities of ECUSTFD's specimens."""

import pytest

from tools.ecustfd import Specimen, measured_density, read_measured, write_measured


def specimens(*densities, volume_ml=200.0):
    return [Specimen(str(number), volume_ml, volume_ml * density) for number, density in enumerate(densities)]


def test_density_is_of_the_possible_fruit_or_all_of_another_food_with_no_less_spread_than_rounding():
    found = measured_density("orange", specimens(0.85, 0.90, 0.95, 1.38, 0.5))
    assert (found.specimens, found.excluded, found.g_per_ml) == (3, 2, 0.9)
    assert found.sd_g_per_ml == pytest.approx(0.05)
    assert measured_density("bread", specimens(0.17, 0.19, 0.21)).g_per_ml == 0.19
    found = measured_density("egg", specimens(1.0, 1.0, 1.0, volume_ml=50.0))
    assert found.sd_g_per_ml == pytest.approx(10.0 / 12.0**0.5 / 50.0, abs=5e-4)
    with pytest.raises(ValueError, match="takes two"):
        measured_density("orange", specimens(0.9, 1.4))


def test_measured_densities_survive_writing_and_reading():
    measured = [measured_density("orange", specimens(0.85, 0.9, 0.95)), measured_density("egg", specimens(1.0, 1.1))]
    assert read_measured(write_measured(measured)) == {density.food: density for density in measured}
