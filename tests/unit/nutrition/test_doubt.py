"""Intervals against known truth, scaling, and a Monte Carlo reference that draws every part on its own."""

import math

import numpy as np
import pytest

from app.nutrition.doubt import Doubt, Estimate, Term, combine, estimate

DRAWS = 400_000  # the 5 % and 95 % points of a sample this size are good to 0.5 % of the spread


def draw(terms, seed=7):
    """Sum of the terms, drawn: one factor a pair, one a food, one an item, each lognormal with median 1."""
    rng = np.random.default_rng(seed)
    shared = {}

    def factor(key, relative_sd):
        if key not in shared:
            shared[key] = rng.standard_normal(DRAWS)
        return np.exp(math.sqrt(math.log1p(relative_sd**2)) * shared[key])

    total = np.zeros(DRAWS)
    for number, term in enumerate(terms):
        total += (
            term.sign
            * term.value
            * factor(("pair", term.pair), term.doubt.pair)
            * factor(("food", term.food), term.doubt.density)
            * factor(("item", number), term.doubt.item)
        )
    return np.quantile(total, [0.05, 0.95])


def test_interval_of_one_item_has_the_lognormal_quantiles():
    found = estimate(100.0, Doubt(pair=0.1, density=0.2, item=0.05))
    low, high = draw([Term(100.0, Doubt(0.1, 0.2, 0.05), "a", "apple")])
    assert found.low == pytest.approx(low, rel=0.005)
    assert found.high == pytest.approx(high, rel=0.005)
    assert found.low * found.high == pytest.approx(found.value**2)


def test_no_doubt_gives_a_point_a_single_term_its_own_estimate_and_nothing_zero():
    assert estimate(100.0, Doubt()) == Estimate(100.0, 100.0, 100.0)
    doubt = Doubt(0.1, 0.2, 0.3)
    alone = combine([Term(80.0, doubt, "a", "apple")])
    expected = estimate(80.0, doubt)
    assert (alone.low, alone.high) == pytest.approx((expected.low, expected.high))
    assert combine([]) == Estimate(0.0, 0.0, 0.0)
    assert combine([Term(0.0, Doubt(0.1, 0.1, 0.1), "a", "tea")]) == Estimate(0.0, 0.0, 0.0)


APPLE = Term(100.0, Doubt(0.1, 0.2, 0.05), "a", "apple")
RICE = Term(200.0, Doubt(0.05, 0.1, 0.06), "before", "rice")


@pytest.mark.parametrize(
    "terms",
    [
        pytest.param([APPLE, Term(150.0, Doubt(0.1, 0.12, 0.1), "a", "rice")], id="one pair, different foods"),
        pytest.param([APPLE] * 3, id="one pair, one food"),
        pytest.param([APPLE, Term(50.0, Doubt(0.05, 0.2, 0.1), "b", "apple")], id="two pairs, one food"),
        pytest.param([APPLE, Term(120.0, Doubt(0.1, 0.2, 0.05), "b", "pear")], id="nothing shared"),
        pytest.param([RICE, Term(60.0, Doubt(0.05, 0.1, 0.08), "after", "rice", -1)], id="before and after"),
        pytest.param([RICE, Term(60.0, Doubt(0.05, 0.1, 0.08), "after", "peas", -1)], id="difference, nothing shared"),
    ],
)
def test_interval_of_a_sum_or_difference_agrees_with_monte_carlo(terms):
    found = combine(terms)
    low, high = draw(terms)
    # Neither a lognormal nor, for a difference, a normal is the very sum: 2 % of the largest value at these spreads.
    most = max(found.value, *(term.value for term in terms))
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.02 * most)
    assert found.value == pytest.approx(sum(term.sign * term.value for term in terms))


@pytest.mark.parametrize("bad", [-0.1, float("nan"), float("inf")])
def test_impossible_spreads_and_amounts_are_refused(bad):
    with pytest.raises(ValueError, match="finite"):
        Doubt(pair=bad)
    with pytest.raises(ValueError, match="finite"):
        Term(bad, Doubt(), "a", "apple")
    with pytest.raises(ValueError, match="finite"):
        estimate(bad, Doubt())
    with pytest.raises(ValueError, match="finite"):
        estimate(1.0, Doubt()).scaled(bad)
