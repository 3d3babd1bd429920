"""How far two reviewers, or methods, agree: kappa, ICC, limits of agreement, correlation, with 95 % intervals. Pure.

Plain Python, since a server process loads no numpy: quantiles of F are found by halving, from the
incomplete beta function.
"""

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

NORMAL = 1.959963984540054  # two-sided 95 %
LIMIT_SDS = 1.96
LEAST = 3  # pairs
# of a continued fraction that converges within the square root of the degrees of freedom
TERMS = 400
MOST_R = 1 - 2**-53  # z of 1 is infinite
HALVINGS = 60  # more than a double has bits

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Amounts:
    """Amounts that two reviewers stated: (the reviewer's, the other's), and how far they agree.

    Figures are None if there are too few pairs; icc also if the differences are all the same.
    bias: mean difference; lower, upper: limits that hold 95 % of the differences
    """

    pairs: Sequence[Pair]
    icc: Figure | None
    bias: Figure | None = None
    lower: Figure | None = None
    upper: Figure | None = None


def cohens_kappa(pairs: Sequence[tuple[str, str]]) -> Figure | None:
    """Return the agreement of names beyond chance; None if there are too few, or all names are the same.

    J. Cohen, Educational and Psychological Measurement 20 (1960) 37; its large-sample variance by
    J. L. Fleiss, J. Cohen and B. S. Everitt, Psychological Bulletin 72 (1969) 323, eq. 13.
    """
    n = len(pairs)
    first, second = Counter(a for a, _ in pairs), Counter(b for _, b in pairs)
    if n < LEAST or len(first | second) == 1:
        return None
    by_chance = sum(first[name] * second[name] for name in first) / n**2
    observed = sum(a == b for a, b in pairs) / n
    scale, error = 1 - by_chance, 1 - observed
    variance = -((observed * by_chance - 2 * by_chance + observed) ** 2)
    for a, b in pairs:
        margins = (second[a] + first[b]) / n
        variance += (scale - margins * error if a == b else margins * error) ** 2 / n
    kappa = (observed - by_chance) / scale
    margin = NORMAL * math.sqrt(max(variance, 0.0) / n) / scale**2
    return Figure(kappa, kappa - margin, kappa + margin)


def agreement_of(pairs: Sequence[Pair]) -> Amounts:
    """Return how far amounts agree.

    J. M. Bland and D. G. Altman, Lancet 327 (1986) 307, and Statistical Methods in Medical Research
    8 (1999) 135: the variance of the mean difference is s^2 / n, of a limit about 3 s^2 / n.
    """
    n = len(pairs)
    if n < LEAST:
        return Amounts(pairs, None)
    differences = [a - b for a, b in pairs]
    bias, sd = statistics.fmean(differences), statistics.stdev(differences)
    error = math.sqrt(f_quantile(0.95, 1, n - 1) / n) * sd  # the square of a two-sided t is an F
    wide = math.sqrt(3) * error
    low, high = bias - LIMIT_SDS * sd, bias + LIMIT_SDS * sd
    return Amounts(
        pairs,
        icc_2_1(pairs),
        Figure(bias, bias - error, bias + error),
        Figure(low, low - wide, low + wide),
        Figure(high, high - wide, high + wide),
    )


def correlation_of(pairs: Sequence[Pair]) -> Figure | None:
    """Return Pearson's correlation, with an interval by Fisher's z; None if a side is the same everywhere.

    R. A. Fisher, Metron 1 (1921) 3: z has a standard error of 1 / sqrt(n - 3).
    """
    n, sides = len(pairs), list(zip(*pairs, strict=True))
    if n <= LEAST or any(len(set(side)) == 1 for side in sides):
        return None
    r = max(-MOST_R, min(MOST_R, statistics.correlation(*sides)))
    margin = NORMAL / math.sqrt(n - LEAST)
    return Figure(r, math.tanh(math.atanh(r) - margin), math.tanh(math.atanh(r) + margin))


def icc_2_1(pairs: Sequence[Pair]) -> Figure | None:
    """Return the intraclass correlation: two-way random effects, absolute agreement, of one of two raters.

    None if the raters differ by the same everywhere. P. E. Shrout and J. L. Fleiss, Psychological
    Bulletin 86 (1979) 420, case 2; its interval by K. O. McGraw and S. P. Wong, Psychological
    Methods 1 (1996) 30, table 7, with k = 2 raters.
    """
    n, differences = len(pairs), [a - b for a, b in pairs]
    rows = 2 * statistics.variance([(a + b) / 2 for a, b in pairs])
    columns = n * statistics.fmean(differences) ** 2 / 2
    error = statistics.variance(differences) / 2
    if error == 0.0:
        return None
    icc = (rows - error) / (rows + error + 2 * (columns - error) / n)
    of_columns, of_rest = 2 * icc * columns / error, n * (1 + icc) - 2 * icc
    whole = (n - 1) * of_columns**2 + of_rest**2
    freedom = (n - 1) * (of_columns + of_rest) ** 2 / whole if whole else 0.0
    freedom = max(freedom, 1.0)  # less only where they agree less than by chance
    by_low, by_high = f_quantile(0.975, n - 1, freedom), f_quantile(0.975, freedom, n - 1)
    spread = 2 * columns + (n - 2) * error
    low = n * (rows - by_low * error) / (by_low * spread + n * rows)
    high = n * (by_high * rows - error) / (spread + n * by_high * rows)
    return Figure(icc, low, high)


def f_quantile(probability: float, numerator: float, denominator: float) -> float:
    """Return the quantile of F with these degrees of freedom, >= 1, whole or not."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        x = (low + high) / 2
        if incomplete_beta(x, numerator / 2, denominator / 2) < probability:
            low = x
        else:
            high = x
    return denominator * low / (numerator * (1 - low))


def incomplete_beta(x: float, a: float, b: float) -> float:
    """Return the regularised incomplete beta function I_x(a, b), 0 < x < 1.

    NIST Digital Library of Mathematical Functions, 8.17.22.
    """
    if x > (a + 1) / (a + b + 2):
        return 1 - incomplete_beta(1 - x, b, a)
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    log_front += a * math.log(x) + b * math.log1p(-x)
    rest = divisor = 1.0
    for m in range(TERMS, -1, -1):
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        divisor = 1 + odd / rest
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)) if m else 0.0
        rest = 1 + even / divisor
    return math.exp(log_front) / a / divisor
