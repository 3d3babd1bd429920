"""One person's mean of a few days beside a reference intake: what may be said, and mostly that nothing may. Pure.

The interval is of the mean over days as they happened to be (Student's t, 90 %); the doubt of the measurement is not in
it. An RDA or AI is a goal: a mean surely above it reaches it. Below an RDA means less than recommended, not too little;
below an AI means nothing, since nobody knows what less would do (IOM 2000, Dietary Reference Intakes: Applications in
Dietary Assessment, chapter 3). Above the CDRR, eating less lowers the risk of chronic disease.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import stdtrit

MIN_DAYS = 3  # with fewer, the interval of a mean holds nearly everything
LEVEL = 0.90

Kind = Literal["rda", "ai", "cdrr"]
Verdict = Literal["reaches", "below", "above_limit", "under_limit", "open", "open_adequate", "open_coverage"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """A mean of days with its 90 % interval, in the reference's unit, and the verdict.

    open: the days do not tell. open_adequate: below an AI. open_coverage: not all contents are known, so the mean is a
    lower bound.
    """

    mean: float
    low: float
    high: float
    days: int
    reference: float
    kind: Kind
    verdict: Verdict


def compare_intake(daily: Sequence[float], reference: float, kind: Kind, *, is_covered: bool) -> Comparison:
    """Compare a person's days with a reference. is_covered: whether the amounts are of everything that was eaten.

    Raises ValueError for fewer than MIN_DAYS days, amounts that are not finite, or a reference that is not positive.
    """
    days = np.asarray(daily, dtype=np.float64)
    if days.size < MIN_DAYS or not np.isfinite(days).all() or not (math.isfinite(reference) and reference > 0.0):
        raise ValueError(f"a comparison needs {MIN_DAYS} days of finite amounts and a positive reference")
    mean = float(days.mean())
    half = float(stdtrit(days.size - 1, (1.0 + LEVEL) / 2.0) * days.std(ddof=1) / math.sqrt(days.size))
    low, high = max(mean - half, 0.0), max(mean + half, 0.0)
    return Comparison(
        mean, low, high, days.size, reference, kind, _verdict(low, high, reference, kind, is_covered=is_covered)
    )


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
