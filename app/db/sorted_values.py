"""Sorted values stored as bytes; the median of many such runs is found without merging them.

Used for the amounts that a study's participants ate on a day (diary/models.py, StudyDaySum).
"""

import math
import struct
import sys
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Self

MOMENTS = struct.Struct("<dd")  # mean, sum of squared differences from it; stored before the values
SORT_LIMIT = 2000  # up to this many values, sorting is faster than another partition


@dataclass(frozen=True, slots=True)
class SortedValues:
    """values: sorted. mean: 0 if there are none. squares: the sum of their squared differences from the mean."""

    values: "array[float]"
    mean: float
    squares: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Create from values in any order."""
        ordered = array("d", sorted(values))
        if not ordered:
            return cls(ordered, 0.0, 0.0)
        mean = math.fsum(ordered) / len(ordered)
        return cls(ordered, mean, math.fsum((value - mean) ** 2 for value in ordered))

    @classmethod
    def from_bytes(cls, stored: bytes) -> Self:
        """Create from the result of `to_bytes`."""
        if not stored:
            return cls(array("d"), 0.0, 0.0)
        values = array("d")
        values.frombytes(memoryview(stored)[MOMENTS.size :])
        return cls(_little_endian(values), *MOMENTS.unpack_from(stored))

    def to_bytes(self) -> bytes:
        """Return the moments and values as little-endian doubles; empty if there are no values."""
        if not self.values:
            return b""
        return MOMENTS.pack(self.mean, self.squares) + _little_endian(self.values).tobytes()

    def __len__(self) -> int:
        return len(self.values)

    @property
    def median(self) -> float:
        """Return the median; requires a value."""
        return (self.values[(len(self) - 1) // 2] + self.values[len(self) // 2]) / 2.0


@dataclass(frozen=True, slots=True)
class Runs:
    """Several non-empty runs of values, treated as one."""

    runs: Sequence[SortedValues]

    @classmethod
    def of(cls, runs: Iterable[SortedValues]) -> Self:
        """Create from these runs, without the empty ones."""
        return cls([run for run in runs if run.values])

    def __len__(self) -> int:
        return sum(map(len, self.runs))

    @property
    def mean(self) -> float:
        """Return the mean; requires a value."""
        return math.fsum(run.mean * len(run) for run in self.runs) / len(self)

    @property
    def squares(self) -> float:
        """Return the sum of squared differences from the mean (merged as in Chan, Golub and LeVeque 1979)."""
        mean = self.mean
        return math.fsum(run.squares + len(run) * (run.mean - mean) ** 2 for run in self.runs)

    @property
    def least(self) -> float:
        """Return the smallest value; requires a value."""
        return min(run.values[0] for run in self.runs)

    @property
    def greatest(self) -> float:
        """Return the largest value; requires a value."""
        return max(run.values[-1] for run in self.runs)

    @property
    def median(self) -> float:
        """Return the median; requires a value."""
        count = len(self)
        low = self.at((count - 1) // 2)
        if count % 2 or self.up_to(low) > count // 2:
            return low
        ends = ((run.values, bisect_right(run.values, low)) for run in self.runs)
        return (low + min(values[end] for values, end in ends if end < len(values))) / 2.0

    def below(self, value: float) -> int:
        """Return how many values are less than this."""
        return sum(bisect_left(run.values, value) for run in self.runs)

    def up_to(self, value: float) -> int:
        """Return how many values are not greater than this."""
        return sum(bisect_right(run.values, value) for run in self.runs)

    def at(self, rank: int) -> float:
        """Return the value of this rank, from 0 to len - 1, by repeated partition around a pivot."""
        remaining = [(run.values, 0, len(run)) for run in self.runs]
        while sum(end - start for _, start, end in remaining) > SORT_LIMIT:
            middles = sorted(values[(start + end) // 2] for values, start, end in remaining)
            pivot = middles[len(middles) // 2]
            lows = [bisect_left(values, pivot, start, end) for values, start, end in remaining]
            highs = [bisect_right(values, pivot, start, end) for values, start, end in remaining]
            less = sum(low - start for low, (_, start, _) in zip(lows, remaining, strict=True))
            same = sum(high - low for low, high in zip(lows, highs, strict=True))
            if less <= rank < less + same:
                return pivot
            if rank < less:
                kept = [(values, start, low) for low, (values, start, _) in zip(lows, remaining, strict=True)]
            else:
                kept = [(values, high, end) for high, (values, _, end) in zip(highs, remaining, strict=True)]
                rank -= less + same
            remaining = [part for part in kept if part[1] < part[2]]
        return sorted(chain.from_iterable(values[start:end] for values, start, end in remaining))[rank]


def _little_endian(values: "array[float]") -> "array[float]":
    if sys.byteorder == "big":
        values = array("d", values)
        values.byteswap()
    return values
