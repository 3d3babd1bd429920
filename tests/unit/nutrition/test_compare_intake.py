import math

import pytest
from scipy.special import stdtrit

from app.nutrition.intakes.compare_intake import LEVEL, compare_intake, student_t


def test_interval_of_three_days_is_students():
    found = compare_intake([80.0, 100.0, 120.0], 90.0, "rda", is_covered=True)
    assert found.mean == 100.0
    assert found.high - found.mean == pytest.approx(2.919986 * 20.0 / math.sqrt(3))  # t of 2 degrees, 95 %
    assert found.verdict == "open"


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 13, 365])
def test_students_t_is_scipys(freedom):
    assert student_t(freedom) == pytest.approx(float(stdtrit(freedom, (1.0 + LEVEL) / 2.0)), rel=1e-10)


@pytest.mark.parametrize(
    ("daily", "kind", "is_covered", "verdict"),
    [
        ([100.0, 101.0, 99.0], "rda", True, "reaches"),
        ([100.0, 101.0, 99.0], "ai", False, "reaches"),  # a lower bound that is above is above
        ([100.0, 101.0, 99.0], "cdrr", True, "above_limit"),
        ([50.0, 51.0, 49.0], "rda", True, "below"),
        ([50.0, 51.0, 49.0], "ai", True, "open_adequate"),
        ([50.0, 51.0, 49.0], "cdrr", True, "under_limit"),
        ([50.0, 51.0, 49.0], "rda", False, "open_coverage"),
        ([90.0, 90.0, 90.0], "rda", True, "reaches"),
    ],
)
def test_verdict_says_no_more_than_the_days_and_the_reference(daily, kind, is_covered, verdict):
    assert compare_intake(daily, 90.0, kind, is_covered=is_covered).verdict == verdict


@pytest.mark.parametrize(
    ("daily", "reference"), [([1.0, 2.0], 1.0), ([1.0, 2.0, math.nan], 1.0), ([1.0, 2.0, 3.0], 0.0)]
)
def test_too_few_days_and_bad_figures_are_refused(daily, reference):
    with pytest.raises(ValueError, match="3 days"):
        compare_intake(daily, reference, "rda", is_covered=True)
