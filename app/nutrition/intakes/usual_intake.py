"""Estimate the share of a group whose usual intake is below the EAR, from a few days of each person. Pure.

Means of a few days scatter more than usual intakes, since days differ: unadjusted, far too many are
below (or above) a cut-point. So each person's mean is shrunk towards the group's until the means
scatter as usual intakes do (National Research Council 1986, Nutrient Adequacy; Institute of
Medicine 2000, Dietary Reference Intakes: Applications in Dietary Assessment, chapter 4 and appendix
E), on a scale where days are nearly normal:

    t_i = m + (mean_i - m) sqrt(b / (b + w / k_i))

with b, w the variances between persons and within them, k_i the person's number of days. On the
scale of amounts a usual intake is the mean over days, not the transform of t_i: t_i is averaged
over the within-person scatter (as in Nusser et al. 1996). Then persons below the EAR are counted
(the EAR cut-point, Beaton 1994).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from statistics import NormalDist
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from app.core.shares import wilson_interval

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.intp]
Scale = Literal["as_is", "square_root", "cube_root", "fourth_root", "logarithm"]
Reason = Literal["too_few_persons", "no_repeated_days", "no_difference_between_persons"]

MIN_PERSONS = 10  # in a smaller group one person is more than a tenth
LEVEL = 0.90  # of the intervals
BOOTSTRAPS = 500  # the limits of an interval then vary by about a hundredth between draws
QUADRATURE_POINTS = 15  # exact for polynomials to degree 29, far beyond a fourth power
MOST_STEPS = 100  # of Newton's method; each step leaves at most three quarters of the distance
ROUNDING = 1e-13  # of a threshold: steps below it change nothing
DRAWN_AT_ONCE = 100_000  # persons per block of draws, so that a block fits the processor's cache
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(QUADRATURE_POINTS)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()
_NORMAL = NormalDist()
_POWERS: Mapping[Scale, float] = {
    "as_is": 1.0,
    "square_root": 2.0,
    "cube_root": 3.0,
    "fourth_root": 4.0,
}


@dataclass(frozen=True, slots=True)
class Variances:
    """Variance components on the scale of analysis, from a one-way analysis of variance with unequal numbers of days.

    mean: the group's. between: 0 if the persons differ no more than expected from their days.
    """

    mean: float
    within: float
    between: float


@dataclass(frozen=True, slots=True)
class UsualIntakes:
    """A group's usual intakes, in the unit of the days, and the share below the cut-point with its 90 % interval.

    usual: (n,), one per person, in order. unadjusted_share: of the unadjusted means, for
    comparison.
    """

    persons: int
    days: int
    scale: Scale
    variances: Variances
    usual: Floats
    mean: float
    share_below: float
    share_low: float
    share_high: float
    unadjusted_share: float


@dataclass(frozen=True, slots=True)
class NotJudged:
    """The reason why a group's share cannot be estimated, with the numbers of persons and days."""

    reason: Reason
    persons: int
    days: int

    def __bool__(self) -> bool:
        """Return False, so that `if result` is true only for usual intakes."""
        return False


def judge_group(
    days_by_person: Sequence[Sequence[float]], ear: float, rng: np.random.Generator
) -> UsualIntakes | NotJudged:
    """Estimate the usual intakes of a group and the share below `ear`.

    days_by_person: each person's daily amounts, at least one; differences below zero (more left
    over than served, within the error) count as zero. rng: draws the persons for the interval.
    Raises ValueError for an amount that is not finite, a person without a day, or an EAR that is
    not positive.
    """
    if not (math.isfinite(ear) and ear > 0.0):
        raise ValueError(f"an EAR is positive, not {ear}")
    amounts, counts = _flat(days_by_person)
    if (counts == 0).any() or not np.isfinite(amounts).all():
        raise ValueError("every person needs a day, and every day a finite amount")
    amounts = np.maximum(amounts, 0.0)
    persons, days = counts.size, amounts.size
    if persons < MIN_PERSONS:
        return NotJudged("too_few_persons", persons, days)
    if days == persons:
        return NotJudged("no_repeated_days", persons, days)
    scale = choose_scale(amounts[_starts(counts)])
    sums = PersonSums.of(_onto(scale, amounts), counts)
    variances = sums.variances()
    if variances.between <= 0.0:
        return NotJudged("no_difference_between_persons", persons, days)
    usual = usual_amounts(scale, sums, variances)
    share = float(np.mean(usual < ear))
    low, high = _interval(scale, sums, ear, share, rng)
    return UsualIntakes(
        persons=persons,
        days=days,
        scale=scale,
        variances=variances,
        usual=usual,
        mean=float(usual.mean()),
        share_below=share,
        share_low=low,
        share_high=high,
        unadjusted_share=float(np.mean(np.add.reduceat(amounts, _starts(counts)) / counts < ear)),
    )


def choose_scale(amounts: Floats) -> Scale:
    """Return the scale on which these amounts, (n,), are closest to normal, by their normal plots (Filliben 1975).

    The logarithm is excluded if an amount is 0.
    """
    scales: list[Scale] = list(_POWERS)
    if amounts.min() > 0.0:
        scales.append("logarithm")
    shares = (np.arange(1, amounts.size + 1) - 0.375) / (amounts.size + 0.25)
    quantiles = np.array([_NORMAL.inv_cdf(share) for share in shares])
    return max(scales, key=lambda scale: _straightness(np.sort(_onto(scale, amounts)), quantiles))


@dataclass(frozen=True, slots=True)
class PersonSums:
    """Per-person statistics for the analysis: number of days, their mean, sum of squares about it; (n,) each."""

    counts: Floats
    means: Floats
    squares: Floats

    @classmethod
    def of(cls, amounts: Floats, counts: Counts) -> Self:
        """Compute the statistics.

        amounts: all days, (N,), person after person. counts: days per person, (n,), >= 1.
        """
        starts = _starts(counts)
        means = np.add.reduceat(amounts, starts) / counts
        squares = np.add.reduceat((amounts - np.repeat(means, counts)) ** 2, starts)
        return cls(counts.astype(np.float64), means, squares)

    def drawn(self, indices: Counts) -> Self:
        """Return the statistics of these persons, in this order."""
        return type(self)(self.counts[indices], self.means[indices], self.squares[indices])

    def variances(self) -> Variances:
        """Return the variance components.

        Searle 1971: E(MSB) = w + n0 b, n0 = (N - sum k^2 / N) / (n - 1).
        """
        persons, days = self.counts.size, self.counts.sum()
        if days == persons:  # a draw without repeated days: the two cannot be separated
            return Variances(float(self.means.mean()), 0.0, 0.0)
        within = float(self.squares.sum() / (days - persons))
        weighted = float(np.sum(self.counts * self.means) / days)
        mean_square = float(np.sum(self.counts * (self.means - weighted) ** 2) / (persons - 1))
        n0 = float((days - np.sum(self.counts**2) / days) / (persons - 1))
        between = max((mean_square - within) / n0, 0.0)
        weights = (
            1.0 / (between + within / self.counts)
            if between + within > 0.0
            else np.ones_like(self.counts)
        )
        return Variances(float(np.sum(weights * self.means) / weights.sum()), within, between)


def usual_amounts(scale: Scale, sums: PersonSums, variances: Variances) -> Floats:
    """Return each person's usual amount, (n,)."""
    if variances.between <= 0.0:
        shrunk = np.full_like(sums.means, variances.mean)
    else:
        shrink = np.sqrt(variances.between / (variances.between + variances.within / sums.counts))
        shrunk = variances.mean + (sums.means - variances.mean) * shrink
    averaged: Floats = (
        _back(scale, shrunk[:, None] + math.sqrt(variances.within) * _NODES) @ _WEIGHTS
    )
    return averaged


def drawn_shares(scale: Scale, sums: PersonSums, ear: float, rng: np.random.Generator) -> Floats:
    """Return the share below `ear` in each of BOOTSTRAPS resampled groups of the same size, (BOOTSTRAPS,).

    Equals `np.mean(usual_amounts(scale, drawn, drawn.variances()) < ear)` of each, without
    computing the amounts: they increase with the person's mean, so each draw and number of days has
    a mean below which they are below the EAR.
    """
    persons = sums.counts.size
    order = np.lexsort((sums.means, sums.counts))  # by number of days; then by mean
    ordered = sums.drawn(order)
    shares = []
    for draws in _blocks(BOOTSTRAPS, max(1, DRAWN_AT_ONCE // persons)):
        indices = rng.integers(0, persons, (draws, persons))
        times = np.array(
            [np.bincount(draw, minlength=persons)[order] for draw in indices], dtype=np.float64
        )
        shares.append(_shares_below(scale, ordered, times, ear))
    return np.concatenate(shares)


def _shares_below(scale: Scale, sums: PersonSums, times: Floats, ear: float) -> Floats:
    """Return the share below `ear` of each draw, (d,).

    sums: (n,), ordered by number of days, then by mean.

    times: (d, n), how many times each person was drawn.
    """
    k, firsts = np.unique(sums.counts, return_index=True)
    parts = [
        slice(first, end)
        for first, end in zip(firsts, [*firsts[1:], sums.counts.size], strict=True)
    ]
    mean, within, between = _variances_of_draws(sums, times, k, parts)
    limit = _mean_of(scale, ear, within)  # of the adjusted means
    spread = between[:, None] + within[:, None] / k
    shrink = np.sqrt(between[:, None] / np.where(spread > 0.0, spread, 1.0))
    # of the unadjusted ones
    limits = mean[:, None] + (limit - mean)[:, None] / np.where(shrink > 0.0, shrink, 1.0)
    below = np.zeros(len(times))
    for place, part in enumerate(parts):
        ends = np.searchsorted(sums.means[part], limits[:, place])
        up_to = np.cumsum(times[:, part], axis=1)
        below += np.where(ends > 0, up_to[np.arange(len(times)), ends - 1], 0.0)
    return np.where(between > 0.0, below / sums.counts.size, mean < limit)


def _variances_of_draws(
    sums: PersonSums, times: Floats, k: Floats, parts: Sequence[slice]
) -> tuple[Floats, Floats, Floats]:
    """Return (mean, within, between) of each draw, (d,) each, equal to PersonSums.variances.

    k: (K,), the distinct numbers of days. parts: (K,), the persons of each.
    """
    middle = sums.means.mean()  # squares are summed about it, since about 0 they would lose digits
    means = sums.means - middle
    terms = np.column_stack([np.ones_like(means), means, means**2, sums.squares])
    of_parts = np.stack([times[:, part] @ terms[part] for part in parts], axis=1)  # (d, K, 4)
    n, first_moment, second_moment, squares = of_parts.transpose(2, 0, 1)
    persons, days = sums.counts.size, n @ k
    is_repeated = days > persons
    within = np.where(
        is_repeated, squares.sum(axis=1) / np.where(is_repeated, days - persons, 1.0), 0.0
    )
    weighted = ((first_moment @ k) / days)[:, None]
    about = second_moment - 2.0 * weighted * first_moment + weighted**2 * n
    n0 = (days - (n @ k**2) / days) / (persons - 1)
    between = np.where(is_repeated, np.maximum((about @ k / (persons - 1) - within) / n0, 0.0), 0.0)
    spread = between[:, None] + within[:, None] / k
    weights = 1.0 / np.where(spread > 0.0, spread, 1.0)
    mean = middle + np.sum(weights * first_moment, axis=1) / np.sum(weights * n, axis=1)
    return mean, within, between


def _mean_of(scale: Scale, usual: float, within: Floats) -> Floats:
    """Return the adjusted mean that gives this usual amount, for each within-person variance, (d,)."""
    mean = np.full_like(within, _onto(scale, np.array(usual)))
    if scale == "logarithm":
        return mean - np.log(np.exp(np.sqrt(within)[:, None] * _NODES) @ _WEIGHTS)
    # Newton's method from above: the usual amount is convex in the mean, and at least the amount of
    # the mean
    power = _POWERS[scale]
    for _ in range(MOST_STEPS):
        days = np.maximum(mean[:, None] + np.sqrt(within)[:, None] * _NODES, 0.0)
        slope = power * np.where(days > 0.0, days ** (power - 1.0), 0.0) @ _WEIGHTS
        step = (days**power @ _WEIGHTS - usual) / slope
        mean = mean - step
        if np.all(np.abs(step) <= ROUNDING * (np.abs(mean) + np.sqrt(within))):
            break
    return mean


def _interval(
    scale: Scale, sums: PersonSums, ear: float, share: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the 90 % interval of the share: the wider one of resampled persons and of a binomial count (Wilson)."""
    persons = sums.counts.size
    low, high = np.quantile(
        drawn_shares(scale, sums, ear, rng), [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0]
    )
    z = _NORMAL.inv_cdf((1.0 + LEVEL) / 2.0)
    least, most = wilson_interval(share, persons, z)
    return max(min(float(low), least, share), 0.0), min(max(float(high), most, share), 1.0)


def _flat(days_by_person: Sequence[Sequence[float] | Floats]) -> tuple[Floats, Counts]:
    """Return all days, (N,), person after person, and the number of days per person, (n,)."""
    counts = np.array([len(person) for person in days_by_person], dtype=np.intp)
    return np.fromiter(chain.from_iterable(days_by_person), np.float64, int(counts.sum())), counts


def _starts(counts: Counts) -> Counts:
    """Return the index of each person's first day, (n,)."""
    return np.cumsum(counts) - counts


def _blocks(count: int, most: int) -> Iterator[int]:
    """Yield block sizes of at most `most` that add up to `count`."""
    for done in range(0, count, most):
        yield min(most, count - done)


def _onto(scale: Scale, amounts: Floats) -> Floats:
    transformed: Floats = (
        np.log(amounts) if scale == "logarithm" else amounts ** (1.0 / _POWERS[scale])
    )
    return transformed


def _back(scale: Scale, values: Floats) -> Floats:
    amounts: Floats = (
        np.exp(values) if scale == "logarithm" else np.maximum(values, 0.0) ** _POWERS[scale]
    )
    return amounts


def _straightness(ordered: Floats, places: Floats) -> float:
    spread = float(ordered.std())
    return float(np.corrcoef(ordered, places)[0, 1]) if spread > 0.0 else 0.0
