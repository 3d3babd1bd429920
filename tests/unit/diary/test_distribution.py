"""How a nutrient lies over days: every value is in exactly one bin or told as lying outside, and figures are true."""

import statistics
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.diary.distribution import USUAL_BINS, distribution

AMOUNTS = st.integers(min_value=-(10**7), max_value=10**8).map(lambda number: number / 1000)


def of(values):
    return distribution("energy_kcal", values)


@given(st.lists(AMOUNTS, min_size=2, max_size=300))
def test_every_value_is_in_one_bin_or_outside_and_figures_are_those_of_the_statistics_module(values):
    found = of(values)
    assert found.days_below_bins + sum(found.counts) + found.days_above_bins == len(values) == found.days
    assert all(low < high for low, high in pairwise(found.edges))
    assert len(found.edges) == len(found.counts) + 1 <= 2 * USUAL_BINS + 3
    last = len(found.counts) - 1
    for number, ((low, high), count) in enumerate(zip(pairwise(found.edges), found.counts, strict=True)):
        assert count == sum(low <= value < high or (number == last and value == high) for value in values)
    assert found.days_below_bins == sum(value < found.edges[0] for value in values)
    assert found.days_above_bins == sum(value > found.edges[-1] for value in values)
    spread = max(map(abs, values)) or 1.0
    assert found.mean == pytest.approx(statistics.fmean(values), rel=1e-9, abs=1e-9 * spread)
    assert found.median == pytest.approx(statistics.median(values), rel=1e-9, abs=1e-9 * spread)
    assert found.sd == pytest.approx(statistics.stdev(values), rel=1e-9, abs=1e-9 * spread)
    assert (found.minimum, found.maximum) == (min(values), max(values))


def test_bins_begin_at_zero_and_are_of_a_round_width_also_for_an_outlier_one_day_or_none():
    found = of([float(value) for value in range(1200, 3201, 10)])
    assert found.edges[:3] == (0.0, 200.0, 400.0)
    assert (found.edges[-1], found.days_below_bins, found.days_above_bins) == (3200.0, 0, 0)
    found = of([2000.0 + number for number in range(200)] + [90_000.0])
    assert (found.days_above_bins, found.maximum, found.edges[-1]) == (1, 90_000.0, 2200.0)
    assert (of([0.0, 0.0]).counts, of([0.0, 0.0]).mean) == ((2,), 0.0)
    found = of([])
    assert (found.days, found.mean, found.sd, found.median, found.edges, found.counts) == (0, None, None, None, (), ())
    assert (of([5.0]).sd, of([5.0]).median) == (None, 5.0)
