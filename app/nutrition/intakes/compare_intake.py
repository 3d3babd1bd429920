"""Compare one person's mean of a few days with a reference intake; the verdict is mostly open.

Pure.

The interval is of the mean over the observed days (Student's t, 90 %), without the uncertainty of
the measurement. An RDA or AI is a goal: a mean whose whole interval is above it reaches it. Below
an RDA means less than recommended, not too little; below an AI means nothing, since the effect of
less is not known (IOM 2000, Dietary Reference Intakes: Applications in Dietary Assessment, chapter
3). Above the CDRR, eating less lowers the risk of chronic disease.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from statistics import fmean, stdev
from typing import Literal

MIN_DAYS = 3  # with fewer, the interval of a mean contains nearly everything
LEVEL = 0.90

Kind = Literal["rda", "ai", "cdrr"]
Verdict = Literal[
    "reaches", "below", "above_limit", "under_limit", "open", "open_adequate", "open_coverage"
]


@dataclass(frozen=True, slots=True)
class Comparison:
    """A mean of days with its 90 % interval, in the reference's unit, and the verdict.

    open: the days do not decide. open_adequate: below an AI. open_coverage: not all contents are
    known, so the mean is a lower bound.
    """

    mean: float
    low: float
    high: float
    days: int
    reference: float
    kind: Kind
    verdict: Verdict

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 90 % interval of the mean: (low, high)."""
        return self.low, self.high


def compare_intake(
    daily: Sequence[float], reference: float, kind: Kind, *, is_covered: bool
) -> Comparison:
    """Compare a person's days with a reference.

    is_covered: whether the amounts include everything that was eaten.

    Raises ValueError for fewer than MIN_DAYS days, amounts that are not finite, or a reference that
    is not positive.
    """
    days = len(daily)
    if (
        days < MIN_DAYS
        or not all(map(math.isfinite, daily))
        or not (math.isfinite(reference) and reference > 0.0)
    ):
        raise ValueError(
            f"a comparison needs {MIN_DAYS} days of finite amounts and a positive reference"
        )
    mean = fmean(daily)
    half = student_t(days - 1) * stdev(daily, mean) / math.sqrt(days)
    low, high = max(mean - half, 0.0), max(mean + half, 0.0)
    return Comparison(
        mean,
        low,
        high,
        days,
        reference,
        kind,
        _verdict(low, high, reference, kind, is_covered=is_covered),
    )


@cache
def student_t(freedom: int) -> float:
    """Return the two-sided quantile of Student's t at LEVEL. freedom: degrees of freedom.

    Not from SciPy, which would take 28 MB in every process that serves the API.
    """
    below, above = 0.0, math.pi / 2
    while below < (angle := (below + above) / 2) < above:
        if _share_within(angle, freedom) < LEVEL:
            below = angle
        else:
            above = angle
    return math.sqrt(freedom) * math.tan(angle)


def _share_within(angle: float, freedom: int) -> float:
    """P(|T| < sqrt(freedom) tan(angle)): Abramowitz and Stegun 1964, 26.7.3 (odd) and 26.7.4 (even)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    is_odd = freedom % 2 == 1
    term, total = cosine if is_odd else 1.0, 0.0
    for power in range(1 if is_odd else 0, freedom - 1, 2):
        total += term
        term *= cosine**2 * (power + 1) / (power + 2)
    return 2.0 / math.pi * (angle + sine * total) if is_odd else sine * total


def _verdict(low: float, high: float, reference: float, kind: Kind, *, is_covered: bool) -> Verdict:
    if low >= reference:
        return "above_limit" if kind == "cdrr" else "reaches"
    if not is_covered:
        return "open_coverage"
    if high >= reference:
        return "open"
    if kind == "cdrr":
        return "under_limit"
    return "below" if kind == "rda" else "open_adequate"
