"""Figures of agreement against those of pingouin 0.7.0 and, for kappa, statsmodels 0.15.0, computed once by hand."""

import math
import random

import pytest

from app.records.double_review.agreement import agreement_of, cohens_kappa, correlation_of, f_quantile, icc_2_1
from tests.support.two_reviewers import made_study

# kappa; ICC(A,1); mean difference and limits; each with its 95 % interval
WHOLE = [
    (0.8050287118432679, 0.776759918406456, 0.8332975052800797),
    (0.9000186804914027, 0.8699765396815822, 0.9214501112824962),
    (13.602529312222837, 10.634187668982587, 16.570870955463086),
    (-72.30565620365056, -77.44697474396516, -67.16433766333596),
    (99.51071482809624, 94.36939628778164, 104.65203336841084),
]
FIRST_25 = [
    (0.6880570409982174, 0.4950807101198495, 0.8810333718765853),
    (0.9556534864197438, 0.8521684338967545, 0.9832375356490873),
    (19.625313193150795, 7.092639437351133, 32.15798694895046),
    (-39.88352367039876, -61.59075137012884, -18.176295970668676),
    (79.13415005670035, 57.426922356970266, 100.84137775643043),
]
CLOSE = {"rel": 1e-9, "abs": 1e-9}  # asked: 1e-6


def values(figure):
    return (figure.value, figure.low, figure.high)


@pytest.mark.parametrize(("dishes", "wanted"), [(None, WHOLE), (25, FIRST_25)])
def test_figures_of_the_made_study_are_those_of_pingouin(dishes, wanted):
    pairs = made_study()[:dishes]
    amounts = agreement_of([(a[1], b[1]) for a, b in pairs])
    kappa = cohens_kappa([(a[0], b[0]) for a, b in pairs])
    figures = [kappa, amounts.icc, amounts.bias, amounts.lower, amounts.upper]
    for figure, expected in zip(figures, wanted, strict=True):
        assert values(figure) == pytest.approx(expected, **CLOSE)


def test_reviewers_in_the_other_order_agree_as_much_and_differ_the_other_way():
    pairs = [(a[1], b[1]) for a, b in made_study()[:200]]
    there, back = agreement_of(pairs), agreement_of([pair[::-1] for pair in pairs])
    assert values(back.icc) == pytest.approx(values(there.icc), **CLOSE)
    assert (back.bias.value, back.upper.low) == pytest.approx((-there.bias.value, -there.lower.high), **CLOSE)


def test_scaled_amounts_scale_the_limits_and_not_the_correlation():
    pairs = [(a[1], b[1]) for a, b in made_study()[:50]]
    one, ten = agreement_of(pairs), agreement_of([(10 * a, 10 * b) for a, b in pairs])
    assert values(ten.icc) == pytest.approx(values(one.icc), **CLOSE)
    assert values(ten.upper) == pytest.approx([10 * value for value in values(one.upper)], **CLOSE)


def test_what_says_nothing_has_no_figure():
    assert cohens_kappa([("a", "a")] * 9) is None
    assert cohens_kappa([("a", "b")] * 2) is None
    assert cohens_kappa([("a", "a"), ("b", "b")] * 3).value == 1
    assert agreement_of([(1.0, 2.0)] * 2).bias is None
    assert icc_2_1([(1.0, 1.0), (2.0, 2.0), (3.0, 3.0)]) is None


def test_reviewers_who_disagree_more_than_by_chance_have_an_interval():
    figure = icc_2_1([(0.0, 10.0), (10.0, 0.0), (1.0, 9.0), (9.0, 1.0)])
    assert figure.value < 0
    assert all(map(math.isfinite, values(figure)))


@pytest.mark.parametrize(
    ("probability", "numerator", "denominator", "quantile"),
    [(0.95, 1, 10, 4.964602743730711), (0.975, 839, 1, 1017.6510262302796), (0.975, 3.3, 5, 7.630545082365533)],
)
def test_quantiles_of_f_are_those_of_scipy(probability, numerator, denominator, quantile):
    assert f_quantile(probability, numerator, denominator) == pytest.approx(quantile, rel=1e-9)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """1,000 small studies: a mean difference of 0 is in its 95 % interval in some 950, sd 7."""
    rng = random.Random(5)
    hits = 0
    for _ in range(1000):
        bias = agreement_of([(rng.gauss(0, 1), rng.gauss(0, 1)) for _ in range(12)]).bias
        hits += bias.low < 0 < bias.high
    assert 915 <= hits <= 985


def test_correlation_and_its_interval_are_those_of_scipy():
    """scipy.stats.pearsonr, of which the interval is by Fisher's z."""
    pairs = [(a[1], b[1]) for a, b in made_study()[:25]]
    figure = correlation_of(pairs)
    assert values(figure) == pytest.approx((0.9686012885357015, 0.9290344454171341, 0.9862647163898837), **CLOSE)


def test_correlation_of_equal_sides_is_one_and_of_a_constant_side_none():
    assert values(correlation_of([(x, 2 * x) for x in (1.0, 2.0, 3.0, 4.0)])) == pytest.approx((1, 1, 1))
    assert correlation_of([(0.1, 1.0), (0.1, 2.0), (0.1, 3.0), (0.1, 4.0)]) is None
    assert correlation_of([(1.0, 1.0), (2.0, 3.0), (3.0, 2.0)]) is None
