"""The EAR cut-point with simulated groups whose usual intakes are known."""

import math

import numpy as np
import pytest

from app.nutrition.intakes.usual_intake import (
    BOOTSTRAPS,
    NotJudged,
    PersonSums,
    UsualIntakes,
    choose_scale,
    drawn_shares,
    judge_group,
    usual_amounts,
)


def lognormal_group(rng, persons=400, days=3, median=10.0, between=0.25, within=0.45):
    """(days of each person, usual intakes): lognormal between persons and within; the usual is the mean of days."""
    own = rng.normal(math.log(median), between, persons)
    usual = np.exp(own + within**2 / 2)
    return [np.exp(rng.normal(one, within, days)) for one in own], usual


def normal_group(rng, persons=400, days=2, mean=100.0, between=15.0, within=30.0):
    usual = rng.normal(mean, between, persons)
    return [rng.normal(one, within, days) for one in usual], usual


def judged(days, ear, seed=1) -> UsualIntakes:
    found = judge_group(days, ear, np.random.default_rng(seed))
    assert isinstance(found, UsualIntakes)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("make", [lognormal_group, normal_group])
@pytest.mark.parametrize("true_share", [0.1, 0.3])
def test_known_share_is_recovered_where_the_bare_means_are_biased(make, true_share):
    errors, bare_errors = [], []
    for seed in range(12):
        days, usual = make(np.random.default_rng(seed))
        ear = float(np.quantile(usual, true_share))
        found = judged(days, ear)
        errors.append(found.share_below - true_share)
        bare_errors.append(found.unadjusted_share - true_share)
    assert abs(np.mean(errors)) < 0.025  # 12 groups of 400: the mean's own standard error is about 0.007
    assert np.mean(bare_errors) > 0.05


def sums_of(days):
    return PersonSums.of(np.concatenate(days), np.array([len(person) for person in days]))


def test_balanced_variances_equal_those_of_the_textbook_and_recover_the_known_ones():
    days, _ = normal_group(np.random.default_rng(3), persons=3000, days=3)
    found, amounts = sums_of(days).variances(), np.array(days)
    between_square = 3 * amounts.mean(axis=1).var(ddof=1)
    within_square = amounts.var(axis=1, ddof=1).mean()
    assert found.mean == pytest.approx(amounts.mean())
    assert found.within == pytest.approx(within_square)
    assert found.between == pytest.approx((between_square - within_square) / 3)
    assert found.mean == pytest.approx(100.0, abs=1.5)
    assert math.sqrt(found.within) == pytest.approx(30.0, rel=0.03)
    assert math.sqrt(found.between) == pytest.approx(15.0, rel=0.08)


def test_days_with_nothing_of_it_have_no_logarithm():
    rng = np.random.default_rng(9)
    assert choose_scale(np.array([0.0, *rng.lognormal(0.0, 1.0, 50)])) != "logarithm"
    assert choose_scale(rng.lognormal(0.0, 1.0, 500)) == "logarithm"
    assert choose_scale(rng.normal(100.0, 10.0, 500)) != "logarithm"


@pytest.mark.parametrize(
    ("days", "reason"),
    [
        ([[1.0, 2.0]], "too_few_persons"),
        ([[float(person)] for person in range(1, 40)], "no_repeated_days"),
        ([[5.0, 9.0, 7.0]] * 40, "no_difference_between_persons"),
        ([[0.0, 0.0]] * 40, "no_difference_between_persons"),
    ],
)
def test_group_that_tells_nothing_is_not_judged(days, reason):
    found = judge_group(days, 6.0, np.random.default_rng(0))
    assert isinstance(found, NotJudged)
    assert (found.reason, found.persons) == (reason, len(days))
    assert not found


def test_days_that_never_differ_are_counted_as_they_are_and_a_share_of_none_has_an_interval():
    days = [[float(amount)] * 2 for amount in range(1, 41)]
    found = judged(days, 10.5)
    assert found.share_below == found.unadjusted_share == pytest.approx(0.25)
    assert found.share_low < 0.25 < found.share_high
    days, _ = normal_group(np.random.default_rng(10), persons=50)
    found = judged(days, 1.0)
    assert (found.share_below, found.share_low) == (0.0, 0.0)
    assert 0.03 < found.share_high < 0.1  # one-sided: none of 50 leaves some 5 % possible


def one_by_one(scale, sums, ear, rng):
    """As drawn_shares has it, from the amounts of everybody who was drawn."""
    persons, shares = sums.counts.size, []
    for _ in range(BOOTSTRAPS):
        drawn = sums.drawn(rng.integers(0, persons, persons))
        shares.append(float(np.mean(usual_amounts(scale, drawn, drawn.variances()) < ear)))
    return shares


@pytest.mark.parametrize(("persons", "within"), [(11, 2.0), (100, 0.2)])
@pytest.mark.parametrize(
    ("scale", "power"),
    [("as_is", 1), ("square_root", 2), ("cube_root", 3), ("fourth_root", 4), ("logarithm", None)],
)
def test_draws_have_the_shares_of_their_persons_amounts(scale, power, within, persons):
    """On each scale; with days that scatter not at all, less than persons, and so much that some draws tell nothing."""
    rng = np.random.default_rng(persons)
    own = rng.normal(2.0, 0.5, persons)
    days = [one + within * rng.normal(size=int(rng.integers(1, 7))) for one in own]
    days[0] = np.full(2, own[0])
    sums = sums_of(days if power is None else [np.maximum(person, 0.0) for person in days])
    middle = float(np.median(usual_amounts(scale, sums, sums.variances())))
    for ear in (0.5 * middle, 1.001 * middle, 2.0 * middle):
        fast = drawn_shares(scale, sums, ear, np.random.default_rng(5))
        assert fast.tolist() == pytest.approx(one_by_one(scale, sums, ear, np.random.default_rng(5)), abs=1e-12)


def test_sums_of_persons_are_those_of_their_days_and_draws_without_repeated_ones_go_by_their_mean():
    rng = np.random.default_rng(12)
    sums = sums_of([rng.normal(10.0, 3.0, 2 if place == 0 else 1) for place in range(12)])
    shares = drawn_shares("as_is", sums, 10.0, np.random.default_rng(5))
    assert shares.tolist() == one_by_one("as_is", sums, 10.0, np.random.default_rng(5))
    assert {0.0, 1.0} < set(shares.tolist())
    days = [np.random.default_rng(place).normal(1e3, 1.0, 1 + place % 5) for place in range(30)]
    sums = sums_of(days)
    assert sums.means == pytest.approx(np.array([person.mean() for person in days]), rel=1e-14)
    assert sums.squares == pytest.approx(np.array([person.size * person.var() for person in days]), rel=1e-9)


@pytest.mark.parametrize(
    ("days", "ear"),
    [
        ([[1.0, math.nan]] * 20, 5.0),
        ([[1.0, 2.0]] * 20 + [[]], 5.0),
        ([[1.0, 2.0]] * 20, 0.0),
        ([[1.0]] * 20, math.nan),
    ],
)
def test_bad_calls_raise(days, ear):
    with pytest.raises(ValueError, match=r"EAR|every person"):
        judge_group(days, ear, np.random.default_rng(0))
