"""Distributions of amounts: statistics and a histogram of values that come in sorted runs, one per day."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from app.db.sorted_values import Runs, SortedValues

USUAL_BINS = 20
OUTLIER_SHARE = 0.01  # share of values at either end that may lie outside the bins, so outliers do not flatten the rest
LEAST_WIDTH = 0.01  # of a bin: finer than any amount of a day is known
NO_VALUES = SortedValues.of(())
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # bins are as wide as one of these times a power of ten


class Bin(NamedTuple):
    """Days whose amount lies in a bin: its lower end included, its upper end in the last bin only."""

    component: str
    from_amount: float
    to_amount: float
    days: int


@dataclass(frozen=True, slots=True)
class Distribution:
    """A headline nutrient over whole days. edges: one more than counts, in order; both empty without bins.

    days_below_bins, days_above_bins: days outside the bins. sd: of the sample of days; None for fewer than two.
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
        return [Bin(self.component, *ends, days) for ends, days in zip(pairwise(self.edges), self.counts, strict=True)]


def distribution(
    component: str, values: Iterable[SortedValues], person_means: SortedValues = NO_VALUES, *, binned: bool = True
) -> Distribution:
    """Compute statistics and count the values in about twenty bins of a round width, outliers separately.

    person_means: each person's mean over their days.
    """
    runs = Runs.of(values)
    days = len(runs)
    if not days:
        return Distribution(component, 0)
    edges = _edges(runs, days) if binned else ()
    places = [runs.below(edge) for edge in edges[:-1]] + [runs.up_to(edges[-1])] if binned else [0, days]
    return Distribution(
        component=component,
        days=days,
        mean=runs.mean,
        sd=_sample_sd(runs),
        sd_between_persons=_sample_sd(person_means),
        median=runs.median,
        minimum=runs.least,
        maximum=runs.greatest,
        edges=edges,
        counts=tuple(end - start for start, end in pairwise(places)),
        days_below_bins=places[0],
        days_above_bins=days - places[-1],
    )


def _sample_sd(values: Runs | SortedValues) -> float | None:
    return math.sqrt(values.squares / (len(values) - 1)) if len(values) > 1 else None


def _edges(runs: Runs, days: int) -> tuple[float, ...]:
    """Return round edges from zero, or below it if there are negative values, to above nearly all values."""
    outliers = int(OUTLIER_SHARE * days)
    low, high = min(runs.at(outliers), 0.0), max(runs.at(days - 1 - outliers), 0.0)
    width = max((high - low) / USUAL_BINS, LEAST_WIDTH)
    power = 10.0 ** math.floor(math.log10(width))
    step = next(factor * power for factor in STEPS if factor * power >= width * (1.0 - 1e-9))
    first, last = math.floor(low / step), max(math.ceil(high / step), 1)
    return tuple(round(number * step, 12) for number in range(first, last + 1))
