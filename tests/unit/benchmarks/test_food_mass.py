"""The benchmark of the table's densities: its sums, and that the bar is met over ECUSTFD."""

import pytest

from app.nutrition.foods import Density
from benchmarks.food_mass import BAR_PERCENT, all_errors, food_errors, lines, over_the_bar
from tools.ecustfd import Specimen, read_specimens

DENSITY = Density(1.0, 0.1, "raw", "solid", "measured", "somewhere")


def errors(*densities, sheet="apple"):
    specimens = [Specimen(f"{sheet}{i}", 100.0, 100.0 * g_per_ml) for i, g_per_ml in enumerate(densities)]
    return food_errors(sheet, "apple", specimens, DENSITY)


def test_error_is_of_the_mass_predicted_from_the_volume_or_by_the_others_without_impossible_fruit():
    assert errors(0.8, 1.0).table_percent == pytest.approx((25.0 + 0.0) / 2)
    found = errors(0.8, 1.0, 1.1)
    assert found.others_percent == pytest.approx(100 * (0.25 / 0.8 + 0.05 / 1.0 + 0.2 / 1.1) / 3)
    assert found.floor_percent == pytest.approx(100 * (0.2 / 0.8 + 0.0 + 0.1 / 1.1) / 3)
    assert errors(1.0, 1.16, 1.2, sheet="egg").inside == 2  # exp(1.645 x 0.1) = 1.18
    found = errors(0.8, 0.9, 1.38)
    assert [specimen.name for specimen in found.excluded] == ["apple2"]
    assert len(found.kept) == 2
    assert not errors(1.09, 1.24, sheet="egg").excluded


def test_mean_over_whole_fruit_and_eggs_meets_the_bar(shared_data):
    specimens = read_specimens(shared_data / "photos" / "ecustfd" / "density.xls")
    found = all_errors(specimens)
    means = over_the_bar(found)
    assert max(means["specimens"], means["foods"], means["others"]) <= BAR_PERCENT
    out = {specimen.name for food in found for specimen in food.excluded}
    assert out == {"mango002", "mango005", "mango007", "mango010", "orange001", "orange015"}
    assert "bar 9 %: met" in "\n".join(lines(found, specimens))
