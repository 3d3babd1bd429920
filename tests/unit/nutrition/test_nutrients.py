import pytest

from app.nutrition.components import NUMBER_BY_TAGNAME
from app.nutrition.doubt import Doubt, Estimate
from app.nutrition.foods import load_starter_table
from app.nutrition.mass import estimate_mass
from app.nutrition.nutrients import (
    NOTHING,
    MassTotal,
    Portion,
    amount_interval,
    interval_in_proportion,
    nutrients_in,
    total_mass,
    total_nutrients,
)
from tests.unit.nutrition.make_food import make_density, make_food


def portion(food, grams, pair="a", sign=1):
    mass = estimate_mass(grams, Doubt(pair=0.05, item=0.1), make_density(1.0, 0.05))
    return Portion(food.key, food.per_100_g, mass, pair, sign)


ENERGY, FAT, VITC = (NUMBER_BY_TAGNAME[tagname] for tagname in ("ENERC_KCAL", "FAT", "VITC"))


def test_hundred_edible_grams_hold_the_tables_figures_unknown_content_is_absent_and_zero_is_zero():
    apple = load_starter_table().food("apple")
    mass = estimate_mass(200.0, Doubt(item=0.1), make_density(1.0, 0.0), edible_share=0.5)
    amounts = nutrients_in(apple.per_100_g, mass.edible_g)
    assert {number: amount.value for number, amount in amounts.items()} == pytest.approx(dict(apple.per_100_g))
    assert amounts[ENERGY].high / 52.0 == pytest.approx(mass.edible_g.high / 100.0)
    tea = make_food("tea", per_100_g={"FAT": 0.0})
    amounts = nutrients_in(tea.per_100_g, portion(tea, 100.0).mass.edible_g)
    assert amounts[FAT].value == amounts[FAT].high == 0.0
    assert VITC not in amounts


def test_content_of_0_has_no_interval_but_nothing_eaten_has_and_so_has_as_much_left_as_served():
    grams = portion(make_food("honey"), 20.0).mass.edible_g
    amounts = nutrients_in({"FAT": 0.0, "ENERC_KCAL": 304.0}, grams)
    energy = amounts["ENERC_KCAL"]
    assert amount_interval(amounts["FAT"], grams) is None
    assert interval_in_proportion(0.0, grams) is None
    assert amount_interval(energy, grams) == (energy.low, energy.high)
    assert interval_in_proportion(energy.value, grams) == pytest.approx((energy.low, energy.high))
    assert amount_interval(NOTHING, NOTHING) == interval_in_proportion(0.0, NOTHING) == (0.0, 0.0)
    eaten = Estimate(0.0, -10.0, 10.0)
    amounts = nutrients_in({"ENERC_KCAL": 300.0}, eaten)
    assert amount_interval(amounts["ENERC_KCAL"], eaten) == pytest.approx((-30.0, 30.0))
    assert interval_in_proportion(0.0, eaten) is None  # the content cannot be told from an amount of 0


KNOWN = make_food("apple", per_100_g={"VITC": 4.0, "ENERC_KCAL": 52.0})
UNKNOWN = make_food("pear", per_100_g={"ENERC_KCAL": 57.0})


def test_total_says_how_much_of_the_mass_it_covers():
    totals = total_nutrients([portion(KNOWN, 150.0), portion(UNKNOWN, 50.0)])
    assert totals[VITC].amount.value == pytest.approx(6.0)
    assert totals[VITC].coverage == pytest.approx(0.75)
    assert totals[ENERGY].amount.value == pytest.approx(52.0 * 1.5 + 57.0 * 0.5)
    assert totals[ENERGY].coverage == 1.0
    assert FAT not in totals


def test_coverage_is_of_what_was_eaten_and_of_what_was_left_untouched_says_whether_it_is_known():
    eaten = [portion(KNOWN, 100.0), portion(KNOWN, 90.0, "after", -1), portion(UNKNOWN, 100.0)]
    assert total_nutrients(eaten)[VITC].coverage == pytest.approx(10.0 / 110.0)
    more_left = [portion(KNOWN, 100.0), portion(KNOWN, 104.0, "after", -1), portion(UNKNOWN, 100.0)]
    assert total_nutrients(more_left)[VITC].coverage == 0.0  # differences below zero weigh nothing
    untouched = [portion(food, 100.0, pair, sign) for food in (KNOWN, UNKNOWN) for pair, sign in (("a", 1), ("b", -1))]
    totals = total_nutrients(untouched)
    assert (totals[VITC].coverage, totals[ENERGY].coverage) == (0.0, 1.0)


def test_what_was_left_is_taken_away():
    rice = make_food("rice", per_100_g={"ENERC_KCAL": 130.0})
    eaten = [portion(rice, 200.0, "before"), portion(rice, 60.0, "after", -1)]
    assert total_nutrients(eaten)[ENERGY].amount.value == pytest.approx(130.0 * 1.4)
    assert total_mass(eaten).edible_g.value == pytest.approx(140.0)


def test_total_of_nothing_is_empty_and_of_unknown_masses_alone_unknown_and_not_zero():
    assert dict(total_nutrients([])) == {}
    assert total_mass([]).edible_g.value == 0.0
    assert total_mass([]).unmeasured == 0
    portions = [Portion("soup", {ENERGY: 40.0}, None, "a")]
    assert dict(total_nutrients(portions)) == {}
    assert total_mass(portions) == MassTotal(None, 1)


def test_portion_of_unknown_mass_is_left_out_and_the_total_says_so():
    apple = make_food("apple", per_100_g={"ENERC_KCAL": 52.0})
    soup = make_food("soup", per_100_g={"ENERC_KCAL": 40.0, "FAT": 1.0})
    portions = [portion(apple, 100.0), Portion(soup.key, soup.per_100_g, None, "a")]
    totals = total_nutrients(portions)
    assert totals[ENERGY].amount.value == pytest.approx(52.0)
    assert totals[ENERGY].coverage is None
    assert FAT not in totals
    assert total_mass(portions).edible_g.value == pytest.approx(100.0)
    assert total_mass(portions).unmeasured == 1
