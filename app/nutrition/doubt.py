"""Uncertainty in parts, shared between items or independent; 90 % intervals of amounts, sums and differences.

Errors here multiply (a scale, a density), so each part is a factor with a lognormal distribution;
an interval is never negative and is wider upwards. A part's relative standard deviation r gives the
logarithm's, s = sqrt(ln(1 + r^2)). The value itself is the median. Uncertainty of the nutrient
figures themselves is not included.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

# the normal distribution's 95th percentile: 5 % lie above, 5 % below the mirror image
Z_90 = 1.6448536269514722


@dataclass(frozen=True, slots=True)
class Doubt:
    """Relative standard deviations by part; they add up in squares.

    pair: shared by all items of one pair of photographs (pose, scale). density: shared by all items
    of one food. item: the item's own. Raises ValueError if one is negative or not finite.
    """

    pair: float = 0.0
    density: float = 0.0
    item: float = 0.0

    def __post_init__(self) -> None:
        if not all(0.0 <= part < math.inf for part in (self.pair, self.density, self.item)):
            raise ValueError(f"relative standard deviations are finite and not negative: {self}")

    @property
    def log_variance(self) -> float:
        """Return the variance of the logarithm of all parts together."""
        return _log_variance(self.pair) + _log_variance(self.density) + _log_variance(self.item)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its 90 % interval, all in the same unit."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Estimate":
        """Return the estimate times an exact factor >= 0."""
        if not 0.0 <= factor < math.inf:
            raise ValueError(f"an estimate is scaled by a finite factor >= 0, not {factor}")
        return Estimate(self.value * factor, self.low * factor, self.high * factor)


@dataclass(frozen=True, slots=True)
class Term:
    """One item's amount in a sum or difference.

    value: >= 0. pair, food: terms with the same pair or food share that part of the doubt. sign: -1
    to subtract.
    """

    value: float
    doubt: Doubt
    pair: str
    food: str
    sign: Literal[1, -1] = 1

    def __post_init__(self) -> None:
        if not 0.0 <= self.value < math.inf:
            raise ValueError(f"an amount is finite and not negative, not {self.value}")


def estimate(value: float, doubt: Doubt) -> Estimate:
    """Return a value with its 90 % interval. Raises ValueError if it is negative or not finite."""
    if not 0.0 <= value < math.inf:
        raise ValueError(f"an amount is finite and not negative, not {value}")
    spread = math.exp(Z_90 * math.sqrt(doubt.log_variance))
    return Estimate(value, value / spread, value * spread)


def combine(terms: Sequence[Term]) -> Estimate:
    """Return the signed sum of the terms with its 90 % interval; shared parts combine before independent ones.

    The covariance of two terms is exact: E_i E_j (exp(s) - 1), s the log variance that they share.
    A sum is modelled as the lognormal of the same mean and variance (Fenton 1960); a sum with a
    negative sign, which may be negative, as the normal. An empty sum is 0.
    """
    total = math.fsum(term.sign * term.value for term in terms)
    means = [term.sign * term.value * math.exp(term.doubt.log_variance / 2.0) for term in terms]
    mean = math.fsum(means)
    variance = math.fsum(_covariances(terms, means))
    # rounding may leave a tiny negative number where terms cancel
    sd = math.sqrt(max(variance, 0.0))
    if any(term.sign < 0 for term in terms):
        return Estimate(total, mean - Z_90 * sd, mean + Z_90 * sd)
    if mean == 0.0:
        return Estimate(0.0, 0.0, 0.0)
    log_variance = _log_variance(sd / mean)
    median, spread = mean * math.exp(-log_variance / 2.0), math.exp(Z_90 * math.sqrt(log_variance))
    return Estimate(total, median / spread, median * spread)


def _covariances(terms: Sequence[Term], means: Sequence[float]) -> Iterator[float]:
    """Yield the covariances of all pairs of terms, each doubled; a shared part may differ in size between terms."""
    pair_sds = [math.sqrt(_log_variance(term.doubt.pair)) for term in terms]
    density_sds = [math.sqrt(_log_variance(term.doubt.density)) for term in terms]
    for i, term in enumerate(terms):
        yield means[i] ** 2 * math.expm1(term.doubt.log_variance)
        for j in range(i):
            shared = pair_sds[i] * pair_sds[j] if term.pair == terms[j].pair else 0.0
            if term.food == terms[j].food:
                shared += density_sds[i] * density_sds[j]
            if shared:
                yield 2.0 * means[i] * means[j] * math.expm1(shared)


def _log_variance(relative_sd: float) -> float:
    return math.log1p(relative_sd**2)
