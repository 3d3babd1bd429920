"""Values in their order, kept as bytes: of many such runs a median is found without putting them together.

A day of a study keeps what its participants ate so (diary/models.py, StudyDaySum).
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

MOMENTS = struct.Struct("<dd")  # mean, sum of squared differences from it; before the values
FEW = 2000  # values that are quicker put in order than halved once more


@dataclass(frozen=True, slots=True)
class SortedValues:
    """values: in their order. mean: 0 of no value. squares: the sum of their squared differences from the mean."""

    values: "array[float]"
    mean: float
    squares: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """From values in any order."""
        ordered = array("d", sorted(values))
        if not ordered:
            return cls(ordered, 0.0, 0.0)
        mean = math.fsum(ordered) / len(ordered)
        return cls(ordered, mean, math.fsum((value - mean) ** 2 for value in ordered))

    @classmethod
    def from_bytes(cls, kept: bytes) -> Self:
        """From what `to_bytes` made."""
        if not kept:
            return cls(array("d"), 0.0, 0.0)
        values = array("d")
        values.frombytes(memoryview(kept)[MOMENTS.size :])
        return cls(_little_endian(values), *MOMENTS.unpack_from(kept))

    def to_bytes(self) -> bytes:
        """Little-endian doubles, on every machine; nothing of no value."""
        if not self.values:
            return b""
        return MOMENTS.pack(self.mean, self.squares) + _little_endian(self.values).tobytes()

    def __len__(self) -> int:
        return len(self.values)

    @property
    def median(self) -> float:
        """Of values that are there."""
        return (self.values[(len(self) - 1) // 2] + self.values[len(self) // 2]) / 2.0


@dataclass(frozen=True, slots=True)
class Runs:
    """Runs of values together, as if they were one: those that have a value."""

    runs: Sequence[SortedValues]

    @classmethod
    def of(cls, runs: Iterable[SortedValues]) -> Self:
        """Of these, those without a value left out."""
        return cls([run for run in runs if run.values])

    def __len__(self) -> int:
        return sum(map(len, self.runs))

    @property
    def mean(self) -> float:
        """Of values that are there."""
        return math.fsum(run.mean * len(run) for run in self.runs) / len(self)

    @property
    def squares(self) -> float:
        """The sum of squared differences from the mean (Chan, Golub and LeVeque 1979, of runs put together)."""
        mean = self.mean
        return math.fsum(run.squares + len(run) * (run.mean - mean) ** 2 for run in self.runs)

    @property
    def least(self) -> float:
        """Of values that are there."""
        return min(run.values[0] for run in self.runs)

    @property
    def greatest(self) -> float:
        """Of values that are there."""
        return max(run.values[-1] for run in self.runs)

    @property
    def median(self) -> float:
        """Of values that are there."""
        count = len(self)
        low = self.at((count - 1) // 2)
        if count % 2 or self.up_to(low) > count // 2:
            return low
        ends = ((run.values, bisect_right(run.values, low)) for run in self.runs)
        return (low + min(values[end] for values, end in ends if end < len(values))) / 2.0

    def below(self, value: float) -> int:
        """How many are less than this."""
        return sum(bisect_left(run.values, value) for run in self.runs)

    def up_to(self, value: float) -> int:
        """How many are not greater than this."""
        return sum(bisect_right(run.values, value) for run in self.runs)

    def at(self, rank: int) -> float:
        """The value that has so many before it, from 0 to len - 1: what cannot be it is cut away by halves."""
        left = [(run.values, 0, len(run)) for run in self.runs]
        while sum(end - start for _, start, end in left) > FEW:
            middles = sorted(values[(start + end) // 2] for values, start, end in left)
            pivot = middles[len(middles) // 2]
            lows = [bisect_left(values, pivot, start, end) for values, start, end in left]
            highs = [bisect_right(values, pivot, start, end) for values, start, end in left]
            less = sum(low - start for low, (_, start, _) in zip(lows, left, strict=True))
            same = sum(high - low for low, high in zip(lows, highs, strict=True))
            if less <= rank < less + same:
                return pivot
            if rank < less:
                cut = [(values, start, low) for low, (values, start, _) in zip(lows, left, strict=True)]
            else:
                cut = [(values, high, end) for high, (values, _, end) in zip(highs, left, strict=True)]
                rank -= less + same
            left = [part for part in cut if part[1] < part[2]]
        return sorted(chain.from_iterable(values[start:end] for values, start, end in left))[rank]


def _little_endian(values: "array[float]") -> "array[float]":
    if sys.byteorder == "big":
        values = array("d", values)
        values.byteswap()
    return values
