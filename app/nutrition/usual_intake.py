"""The share of a group whose usual intake lies below the EAR, from a few days of each person. Pure.

Means of a few days scatter more than usual intakes do, since days differ: counted as they are, far too many lie below
(or above) a cut-point. So each person's mean is drawn towards the group's until the means scatter as usual intakes do
(National Research Council 1986, Nutrient Adequacy; Institute of Medicine 2000, Dietary Reference Intakes: Applications
in Dietary Assessment, chapter 4 and appendix E), on a scale where days are nearly normal:

    t_i = m + (mean_i - m) sqrt(b / (b + w / k_i))

with b, w the variances between persons and within them, k_i the person's number of days. Back on the scale of amounts
a usual intake is the mean of days, not the day of the mean: the person's days are averaged over their own scatter
(as in Nusser et al. 1996). Then persons below the EAR are counted (the EAR cut-point, Beaton 1994).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Scale = Literal["as_is", "square_root", "cube_root", "fourth_root", "logarithm"]
Reason = Literal["too_few_persons", "no_repeated_days", "no_difference_between_persons"]

MIN_PERSONS = 10  # of fewer, one person is more than a tenth of the group
LEVEL = 0.90  # of the intervals, as everywhere here
BOOTSTRAPS = 500  # an interval's ends then move by about a hundredth between draws
QUADRATURE_POINTS = 15  # exact for polynomials to degree 29, far beyond a fourth power
_NORMAL = NormalDist()
_POWERS: Mapping[Scale, float] = {"as_is": 1.0, "square_root": 2.0, "cube_root": 3.0, "fourth_root": 4.0}


@dataclass(frozen=True, slots=True)
class Variances:
    """Variance components on the scale of analysis, from a one-way analysis of variance with unequal numbers of days.

    mean: the group's. between: 0 where the persons differ no more than their own days let expect.
    """

    mean: float
    within: float
    between: float


@dataclass(frozen=True, slots=True)
class UsualIntakes:
    """A group's usual intakes, in the unit of the days, and the share below the cut-point with its 90 % interval.

    usual: (n,), one a person, in their order. unadjusted_share: of the bare means, to show what the adjustment does.
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
    """Why a group's share cannot be told, with what is known of it."""

    reason: Reason
    persons: int
    days: int

    def __bool__(self) -> bool:
        """No share is falsy, so that `if found` reads as it should."""
        return False


def judge_group(
    days_by_person: Sequence[Sequence[float]], ear: float, rng: np.random.Generator
) -> UsualIntakes | NotJudged:
    """Usual intakes of a group and the share below `ear`.

    days_by_person: each person's daily amounts, at least one; differences below zero (more left over than served,
    within the error) count as zero. rng: draws the persons for the interval.
    Raises ValueError for an amount that is not finite, a person without a day, or an EAR that is not positive.
    """
    groups = [np.asarray(person, dtype=np.float64) for person in days_by_person]
    if not (math.isfinite(ear) and ear > 0.0):
        raise ValueError(f"an EAR is positive, not {ear}")
    if any(person.size == 0 or not np.isfinite(person).all() for person in groups):
        raise ValueError("every person needs a day, and every day a finite amount")
    groups = [np.maximum(person, 0.0) for person in groups]
    persons, days = len(groups), sum(person.size for person in groups)
    if persons < MIN_PERSONS:
        return NotJudged("too_few_persons", persons, days)
    if days == persons:
        return NotJudged("no_repeated_days", persons, days)
    scale = choose_scale(np.array([person[0] for person in groups]))
    sums = _Sums.of([_onto(scale, person) for person in groups])
    variances = sums.variances()
    if variances.between <= 0.0:
        return NotJudged("no_difference_between_persons", persons, days)
    usual = _usual(scale, sums, variances)
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
        unadjusted_share=float(np.mean([person.mean() < ear for person in groups])),
    )


def choose_scale(amounts: Floats) -> Scale:
    """The scale on which these amounts, (n,), are nearest to normal: the straightest normal plot (Filliben 1975).

    The logarithm is left out where an amount is 0.
    """
    scales: list[Scale] = [*_POWERS, *(["logarithm"] if amounts.min() > 0.0 else [])]  # type: ignore[list-item]
    shares = (np.arange(1, amounts.size + 1) - 0.375) / (amounts.size + 0.25)
    places = np.array([_NORMAL.inv_cdf(share) for share in shares])
    return max(scales, key=lambda scale: _straightness(np.sort(_onto(scale, amounts)), places))


def variance_components(days_by_person: Sequence[Floats]) -> Variances:
    """Mean, within-person and between-person variance of the days.

    Raises ValueError where nobody has two days, or there is only one person.
    """
    if len(days_by_person) < 2 or all(person.size < 2 for person in days_by_person):
        raise ValueError("variances need two persons, one of them with two days")
    return _Sums.of(days_by_person).variances()


@dataclass(frozen=True, slots=True)
class _Sums:
    """What the analysis needs of each person: number of days, their mean, sum of squares about it; (n,) each."""

    counts: Floats
    means: Floats
    squares: Floats

    @classmethod
    def of(cls, days_by_person: Sequence[Floats]) -> "_Sums":
        return cls(
            np.array([float(person.size) for person in days_by_person]),
            np.array([person.mean() for person in days_by_person]),
            np.array([np.sum((person - person.mean()) ** 2) for person in days_by_person]),
        )

    def drawn(self, which: npt.NDArray[np.intp]) -> "_Sums":
        return _Sums(self.counts[which], self.means[which], self.squares[which])

    def variances(self) -> Variances:
        """Searle 1971: E(MSB) = w + n0 b, with n0 = (N - sum k^2 / N) / (n - 1)."""
        persons, days = self.counts.size, self.counts.sum()
        if days == persons:  # a draw without repeated days: nothing tells the two apart
            return Variances(float(self.means.mean()), 0.0, 0.0)
        within = float(self.squares.sum() / (days - persons))
        weighted = float(np.sum(self.counts * self.means) / days)
        mean_square = float(np.sum(self.counts * (self.means - weighted) ** 2) / (persons - 1))
        n0 = float((days - np.sum(self.counts**2) / days) / (persons - 1))
        between = max((mean_square - within) / n0, 0.0)
        weights = 1.0 / (between + within / self.counts) if between + within > 0.0 else np.ones_like(self.counts)
        return Variances(float(np.sum(weights * self.means) / weights.sum()), within, between)


def _usual(scale: Scale, sums: _Sums, variances: Variances) -> Floats:
    """Each person's usual amount, (n,)."""
    if variances.between <= 0.0:
        shrunk = np.full_like(sums.means, variances.mean)
    else:
        shrink = np.sqrt(variances.between / (variances.between + variances.within / sums.counts))
        shrunk = variances.mean + (sums.means - variances.mean) * shrink
    nodes, weights = np.polynomial.hermite_e.hermegauss(QUADRATURE_POINTS)
    days = shrunk[:, None] + math.sqrt(variances.within) * nodes[None, :]
    averaged: Floats = _back(scale, days) @ (weights / weights.sum())
    return averaged


def _interval(scale: Scale, sums: _Sums, ear: float, share: float, rng: np.random.Generator) -> tuple[float, float]:
    """90 % interval of the share: the wider of persons drawn anew (variances and all) and of a bare count (Wilson)."""
    persons = sums.counts.size
    shares = []
    for _ in range(BOOTSTRAPS):
        drawn = sums.drawn(rng.integers(0, persons, persons))
        shares.append(float(np.mean(_usual(scale, drawn, drawn.variances()) < ear)))
    low, high = np.quantile(shares, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    z = _NORMAL.inv_cdf((1.0 + LEVEL) / 2.0)
    centre = (share + z**2 / (2 * persons)) / (1 + z**2 / persons)
    half = z / (1 + z**2 / persons) * math.sqrt(share * (1 - share) / persons + z**2 / (4 * persons**2))
    return max(min(float(low), centre - half, share), 0.0), min(max(float(high), centre + half, share), 1.0)


def _onto(scale: Scale, amounts: Floats) -> Floats:
    found: Floats = np.log(amounts) if scale == "logarithm" else amounts ** (1.0 / _POWERS[scale])
    return found


def _back(scale: Scale, values: Floats) -> Floats:
    found: Floats = np.exp(values) if scale == "logarithm" else np.maximum(values, 0.0) ** _POWERS[scale]
    return found


def _straightness(ordered: Floats, places: Floats) -> float:
    spread = float(ordered.std())
    return float(np.corrcoef(ordered, places)[0, 1]) if spread > 0.0 else 0.0
