"""How far reviewers agree: kappa of foods, ICC and limits of agreement of amounts, with 95 % intervals. Pure.

Plain Python, since a server process loads no numpy: quantiles of F are found by bisection of the
incomplete beta function.
"""

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

CONFIDENCE = 0.95
NORMAL = statistics.NormalDist().inv_cdf(0.5 + CONFIDENCE / 2)
LIMIT_SDS = 1.96
LEAST = 3  # pairs
SMALLEST = 1e-300  # in place of 0 in a continued fraction

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Limits:
    """Mean difference, the first less the second, and the limits that hold 95 % of the differences."""

    bias: Figure
    lower: Figure
    upper: Figure


def cohens_kappa(pairs: Sequence[tuple[str, str]]) -> Figure | None:
    """Return the agreement of names beyond chance; None if there are too few, or all names are the same.

    J. Cohen, Educational and Psychological Measurement 20 (1960) 37; its large-sample variance by
    J. L. Fleiss, J. Cohen and B. S. Everitt, Psychological Bulletin 72 (1969) 323, eq. 13.
    """
    n = len(pairs)
    first, second = Counter(a for a, _ in pairs), Counter(b for _, b in pairs)
    by_chance = sum(count * second[name] for name, count in first.items()) / n**2 if n else 1.0
    if n < LEAST or by_chance == 1.0:
        return None
    observed = sum(a == b for a, b in pairs) / n
    kappa = (observed - by_chance) / (1 - by_chance)
    same = different = 0.0
    for (a, b), count in Counter(pairs).items():
        if a == b:
            margins = (first[a] + second[a]) / n
            same += count / n * ((1 - by_chance) - margins * (1 - observed)) ** 2
        else:
            different += count / n * ((second[a] + first[b]) / n) ** 2
    last = (observed * by_chance - 2 * by_chance + observed) ** 2
    variance = same + (1 - observed) ** 2 * different - last
    error = math.sqrt(max(variance, 0.0) / n) / (1 - by_chance) ** 2
    return Figure(kappa, kappa - NORMAL * error, kappa + NORMAL * error)


def icc_2_1(pairs: Sequence[Pair]) -> Figure | None:
    """Return the intraclass correlation: two-way random effects, absolute agreement, of one rater.

    None if there are too few pairs, or no error to divide by. P. E. Shrout and J. L. Fleiss,
    Psychological Bulletin 86 (1979) 420, case 2; its interval by K. O. McGraw and S. P. Wong,
    Psychological Methods 1 (1996) 30, table 7.
    """
    n, k = len(pairs), 2
    if n < LEAST:
        return None
    raters = [statistics.fmean(column) for column in zip(*pairs, strict=True)]
    mean = statistics.fmean(raters)
    rows = math.fsum(k * (statistics.fmean(pair) - mean) ** 2 for pair in pairs) / (n - 1)
    columns = math.fsum(n * (rater - mean) ** 2 for rater in raters) / (k - 1)
    errors = (
        value - statistics.fmean(pair) - rater + mean
        for pair in pairs
        for value, rater in zip(pair, raters, strict=True)
    )
    error = math.fsum(each**2 for each in errors) / ((n - 1) * (k - 1))
    if error == 0.0:
        return None
    icc = (rows - error) / (rows + (k - 1) * error + k * (columns - error) / n)
    ratio = columns / error
    of_columns, of_rest = k * icc * ratio, n * (1 + (k - 1) * icc) - k * icc
    freedom = ((n - 1) * (k - 1) * (of_columns + of_rest) ** 2) / (
        (n - 1) * of_columns**2 + of_rest**2
    )
    freedom = max(freedom, 1.0)  # less only where the reviewers disagree more than by chance
    tail = 0.5 + CONFIDENCE / 2
    by_low, by_high = f_quantile(tail, n - 1, freedom), f_quantile(tail, freedom, n - 1)
    spread = k * columns + (k * n - k - n) * error
    low = n * (rows - by_low * error) / (by_low * spread + n * rows)
    high = n * (by_high * rows - error) / (spread + n * by_high * rows)
    return Figure(icc, low, high)


def limits_of_agreement(pairs: Sequence[Pair]) -> Limits | None:
    """Return the mean difference and the limits of agreement; None if there are too few pairs.

    J. M. Bland and D. G. Altman, Lancet 327 (1986) 307, and Statistical Methods in Medical Research
    8 (1999) 135: the variance of the mean difference is s^2 / n, of a limit about 3 s^2 / n.
    """
    n = len(pairs)
    if n < LEAST:
        return None
    differences = [a - b for a, b in pairs]
    bias, sd = statistics.fmean(differences), statistics.stdev(differences)
    t = math.sqrt(f_quantile(CONFIDENCE, 1, n - 1))  # the square of a two-sided t is an F
    of_bias = t * sd / math.sqrt(n)
    of_limit = t * sd * math.sqrt(3 / n)
    return Limits(
        *(
            Figure(value, value - margin, value + margin)
            for value, margin in (
                (bias, of_bias),
                (bias - LIMIT_SDS * sd, of_limit),
                (bias + LIMIT_SDS * sd, of_limit),
            )
        )
    )


def share_right(answers: Sequence[bool]) -> Figure:
    """Return the share of right answers, at least one, with the score interval of E. B. Wilson.

    Journal of the American Statistical Association 22 (1927) 209.
    """
    n, share, square = len(answers), statistics.fmean(answers), NORMAL**2
    middle = (share + square / (2 * n)) / (1 + square / n)
    margin = NORMAL / (1 + square / n) * math.sqrt(share * (1 - share) / n + square / (4 * n**2))
    return Figure(share, middle - margin, middle + margin)


def f_quantile(probability: float, numerator: float, denominator: float) -> float:
    """Return the quantile of F with these degrees of freedom, > 0, whole or not."""
    low, high = 0.0, 1.0
    for _ in range(100):  # halves down to the last bit
        x = (low + high) / 2
        if incomplete_beta(x, numerator / 2, denominator / 2) < probability:
            low = x
        else:
            high = x
    x = (low + high) / 2
    return denominator * x / (numerator * (1 - x))


def incomplete_beta(x: float, a: float, b: float) -> float:
    """Return the regularised incomplete beta function I_x(a, b), by Lentz's continued fraction.

    NIST Digital Library of Mathematical Functions, 8.17.22.
    """
    if not 0.0 < x < 1.0:
        return float(x >= 1.0)
    if x > (a + 1) / (a + b + 2):
        return 1 - incomplete_beta(1 - x, b, a)
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    front = math.exp(log_front + a * math.log(x) + b * math.log1p(-x)) / a
    fraction, c, d, m, change = 1.0, 1.0, 0.0, 0, 0.0
    while abs(change - 1) > 1e-15 and m < 10_000:
        half = m // 2
        if m == 0:
            term = 1.0
        elif m % 2 == 0:
            term = half * (b - half) * x / ((a + m - 1) * (a + m))
        else:
            term = -(a + half) * (a + b + half) * x / ((a + m - 1) * (a + m))
        d = 1 / ((1 + term * d) or SMALLEST)
        c = 1 + term / c or SMALLEST
        change = c * d
        fraction *= change
        m += 1
    return front * (fraction - 1)
