"""Distributions of amounts: statistics and a histogram."""

import math
import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

USUAL_BINS = 20
OUTLIER_SHARE = 0.01  # share of values at either end that may lie outside the bins, so outliers do not flatten the rest
LEAST_WIDTH = 0.01  # of a bin: finer than any amount of a day is known
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # bins are as wide as one of these times a power of ten


class Bin(NamedTuple):
    """Days whose amount lies in a bin: its lower end included, its upper end in the last bin only."""

    component: str
    from_amount: float
    to_amount: float
    days: int


@dataclass(frozen=True, slots=True)
class Distribution:
    """A headline nutrient over whole days.

    edges: one more than counts, in order; both empty without bins.
    days_below_bins, days_above_bins: days outside the bins
    sd: of the sample of days; None for fewer than two
    sd_between_persons: the same of the persons' means. Without a day all statistics are None.
    """

    component: str
    days: int
    mean: float | None = None
    sd: float | None = None
    sd_between_persons: float | None = None
    median: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    edges: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()
    days_below_bins: int = 0
    days_above_bins: int = 0

    def bins(self) -> list[Bin]:
        """Return the bins in order."""
        return [
            Bin(self.component, *ends, days)
            for ends, days in zip(pairwise(self.edges), self.counts, strict=True)
        ]


def distribution(
    component: str,
    values: Iterable[float],
    person_means: Sequence[float] = (),
    *,
    binned: bool = True,
) -> Distribution:
    """Compute statistics and count the values in about twenty bins of a round width, outliers separately.

    person_means: each person's mean over their days.
    """
    ordered = sorted(values)
    days = len(ordered)
    if not days:
        return Distribution(component, 0)
    edges = _edges(ordered) if binned else ()
    places = [bisect_left(ordered, edge) for edge in edges[:-1]]
    places += [bisect_right(ordered, edges[-1])] if binned else [0, days]
    return Distribution(
        component=component,
        days=days,
        mean=statistics.fmean(ordered),
        sd=_sample_sd(ordered),
        sd_between_persons=_sample_sd(person_means),
        median=statistics.median(ordered),
        minimum=ordered[0],
        maximum=ordered[-1],
        edges=edges,
        counts=tuple(end - start for start, end in pairwise(places)),
        days_below_bins=places[0],
        days_above_bins=days - places[-1],
    )


def _sample_sd(values: Sequence[float]) -> float | None:
    """The standard deviation of a sample; `statistics.stdev` is exact, and fifty times slower."""
    if len(values) < 2:
        return None
    mean = statistics.fmean(values)
    return math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1))


def _edges(ordered: Sequence[float]) -> tuple[float, ...]:
    """Return round edges from zero, or below it if there are negative values, to above nearly all values."""
    outliers = int(OUTLIER_SHARE * len(ordered))
    low, high = min(ordered[outliers], 0.0), max(ordered[-1 - outliers], 0.0)
    width = max((high - low) / USUAL_BINS, LEAST_WIDTH)
    power = 10.0 ** math.floor(math.log10(width))
    step = next(factor * power for factor in STEPS if factor * power >= width * (1.0 - 1e-9))
    first, last = math.floor(low / step), max(math.ceil(high / step), 1)
    return tuple(round(number * step, 12) for number in range(first, last + 1))
