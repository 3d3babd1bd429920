import math

import pytest

from app.nutrition.intakes.energy_requirement import BMR_SOURCE, Energy, Person, basal_metabolic_rate
from app.nutrition.plausible import PAL, cut_offs, judge_energy

BASAL = Energy(1500.0, "schofield_weight", BMR_SOURCE)


def test_limits_are_the_published_ones_and_of_many_days_those_of_the_rate_and_the_activity_alone():
    for days, published in ((1, [0.87, 2.75]), (2, [0.96, 2.49])):  # of recall at an activity level of 1.55
        assert [round(limit, 2) for limit in cut_offs(days)] == pytest.approx(published, abs=0.011)  # rounded there
    low, high = cut_offs(10**9)
    assert math.log(high / 1.55) == pytest.approx(2 * math.hypot(0.085, 0.15), abs=1e-6)
    assert low * high == pytest.approx(1.55**2)


@pytest.mark.parametrize(
    ("kcal", "verdict"), [(1300.0, "low"), (1310.0, "plausible"), (4120.0, "plausible"), (4140.0, "high")]
)
def test_one_day_is_judged_by_its_ratio_to_the_basal_rate(kcal, verdict):
    found = judge_energy(kcal, 1, BASAL, age_years=40)
    assert found.verdict == verdict
    assert found.ratio == pytest.approx(kcal / 1500)


def test_known_activity_moves_the_limits():
    assert judge_energy(1700.0, 7, BASAL, age_years=40).verdict == "plausible"
    assert judge_energy(1700.0, 7, BASAL, age_years=40, activity="very_active").verdict == "low"
    assert set(PAL) == {"sedentary", "low_active", "active", "very_active"}


@pytest.mark.parametrize(
    ("kcal", "days", "basal", "age", "reason"),
    [
        (None, 3, BASAL, 40, "no_whole_day"),
        (2000.0, 0, BASAL, 40, "no_whole_day"),
        (2000.0, 3, basal_metabolic_rate(Person(30.0)), 40, "basal_rate_unknown"),
        (2000.0, 3, BASAL, 12, "not_an_adult"),
        (2000.0, 3, BASAL, None, "not_an_adult"),
    ],
)
def test_what_cannot_be_judged_is_unknown_with_its_reason(kcal, days, basal, age, reason):
    found = judge_energy(kcal, days, basal, age_years=age)
    assert (found.verdict, found.reason, found.ratio) == ("unknown", reason, None)


@pytest.mark.parametrize(("days", "pal"), [(0, 1.55), (1, 0.0), (1, math.inf)])
def test_limits_of_no_day_or_no_activity_are_refused(days, pal):
    with pytest.raises(ValueError, match="at least one day"):
        cut_offs(days, pal)
