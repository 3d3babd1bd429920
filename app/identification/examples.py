"""Described regions of known foods as arrays that are extended, changed and shortened in place.

Nothing is trained (kernel_classifier), so an example counts as soon as it is there, and no longer
when it is gone. The nearest of hundreds of thousands are found by the leading axes of the metric,
which are principal axes and carry most of a distance; all axes are compared for those alone.
"""

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.identification.food_index import FoodIndex
from app.identification.metric import Vectors
from app.identification.sizes import log_volume

LEADING = 63  # axes: 83 % of the distances within the shipped index
PRESELECTED = 1024  # by the leading axes, of which 256 decide; some hundred more or less of many,
SAMPLED = 20_000  # since how far they reach is estimated from so many, at even steps
ROOM = 1024  # rows, or an eighth of all, by which arrays grow
FACTS = np.dtype(
    [
        ("food", "i4"),
        ("eater", "i8"),
        ("minute", "i2"),
        ("log_ml", "f8"),
        ("share", "f4"),
        ("digest", "u8"),
    ]
)

Facts = NDArray[np.void]
Halves = NDArray[np.float16]


@dataclass(frozen=True, slots=True)
class Example:
    """A confirmed item: vector (d,) by the index's VCM version; the rest as far as it is known.

    name: unique
    day_minute: after local midnight
    eater: any name of the person
    share: of a piece, which n views show: 1 / n
    """

    name: str
    food_key: str
    vector: Vectors
    volume_ml: float | None = None
    day_minute: int = 720
    eater: str | None = None
    share: float = 1.0


class NumberedIndex:
    """An index, and numbers of its foods and of those that are learned beside it."""

    def __init__(self, index: FoodIndex) -> None:
        self.index = index
        self.foods = {food.food_key: number for number, food in enumerate(index.foods)}
        self._tally = _tally_of(index)
        self.examples = Examples(self)
        facts = np.zeros(len(index.labels), FACTS)
        facts["food"] = index.labels
        self.examples.append(list(map(str, range(len(facts)))), index.examples, facts)

    def tally(self) -> Vectors:
        """As Examples.tally, of the index's specimens and of its measured pieces."""
        return np.pad(self._tally, ((0, 0), (0, len(self.foods) - self._tally.shape[1])))


class Examples:
    """A set of examples; not to be changed by one thread while another one reads."""

    def __init__(self, numbered: NumberedIndex) -> None:
        self._numbered = numbered
        self.names: list[str] = []
        self._rows: dict[str, int] = {}
        axes = numbered.index.metric.axes.shape[1]
        self._leading = np.zeros((0, min(LEADING, axes) + 1), np.float32)  # last: their square
        self._vectors = np.zeros((0, axes), np.float16)
        self._facts = np.zeros(0, FACTS)
        self._tally: Vectors | None = None

    def __len__(self) -> int:
        return len(self.names)

    @property
    def facts(self) -> Facts:
        """(n,) FACTS."""
        return self._facts[: len(self)]

    def put(self, examples: Sequence[Example]) -> None:
        """Add examples whose names are new.

        Raises ValueError if a vector is not of the index's length, or not finite.
        """
        if not examples:
            return
        vectors = self._numbered.index.metric.embed(np.stack([each.vector for each in examples]))
        halves = vectors.astype(np.float16)
        foods = self._numbered.foods
        facts = [
            (
                foods.setdefault(each.food_key, len(foods)),
                hash(each.eater),
                each.day_minute,
                log_volume(each.volume_ml),
                each.share,
                _digest(each, half),
            )
            for each, half in zip(examples, halves, strict=True)
        ]
        self.append([each.name for each in examples], halves, np.array(facts, FACTS))

    def append(self, names: Sequence[str], embedded: Halves | Vectors, facts: Facts) -> None:
        """Add rows whose names are new. embedded: (n, k)."""
        if not names:
            return
        begin, end = len(self), len(self) + len(names)
        if end > len(self._facts):
            for array in (self._leading, self._vectors, self._facts):
                array.resize((end + ROOM + end // 8, *array.shape[1:]), refcheck=False)
        leading = embedded[:, :LEADING].astype(np.float32)
        self._leading[begin:end, :-1] = leading
        self._leading[begin:end, -1] = (leading**2).sum(axis=1)
        self._vectors[begin:end], self._facts[begin:end] = embedded, facts
        self._rows.update(zip(names, range(begin, end), strict=True))
        self.names.extend(names)
        self._tally = None

    def take(self, names: Iterable[str]) -> tuple[list[str], Halves, Facts]:
        """Remove those that are there, and return what `append` would add them by."""
        there = [name for name in names if name in self._rows]
        rows = [self._rows[name] for name in there]
        taken = there, self._vectors[rows], self._facts[rows]
        for name in there:
            row, last = self._rows.pop(name), self.names.pop()
            if last != name:
                self.names[row], self._rows[last] = last, row
                for array in (self._leading, self._vectors, self._facts):
                    array[row] = array[len(self)]
            self._tally = None
        return taken

    def near(self, view: Vectors) -> tuple[Halves, NDArray[np.int32]]:
        """The examples that may be nearest to a region, (k,), embedded as it is, and their foods."""
        apart = self._leading[: len(self)] @ np.append(-2.0 * view[:LEADING], 1.0).astype("f4")
        step = 1 + len(self) // SAMPLED
        some = np.sort(apart[::step])
        rows = np.flatnonzero(apart <= some[min(PRESELECTED // step, len(some)) - 1])
        return self._vectors[rows], self._facts["food"][rows]

    def tally(self) -> Vectors:
        """(4, foods): pieces, those with a volume, sums of log volumes and of their squares."""
        count = len(self._numbered.foods)
        if self._tally is None or self._tally.shape[1] < count:
            foods, logs = self.facts["food"], self.facts["log_ml"]
            has_volume = np.isfinite(logs)
            logs = np.where(has_volume, logs, 0.0)
            weights = (self.facts["share"], has_volume, logs, logs**2)
            self._tally = np.stack([np.bincount(foods, each, count) for each in weights])
        return self._tally


def _tally_of(index: FoodIndex) -> Vectors:
    tally = np.zeros((4, len(index.foods)))
    for label, _ in set(zip(index.labels.tolist(), index.specimens, strict=True)):
        tally[0, label] += 1.0
    for number, food in enumerate(index.foods):
        for log_ml in map(log_volume, index.volumes_ml.get(food.label, ())):
            if math.isfinite(log_ml):
                tally[1:, number] += 1.0, log_ml, log_ml**2
    return tally


def _digest(example: Example, half: Halves) -> int:
    words = (
        example.name,
        example.food_key,
        example.volume_ml,
        example.day_minute,
        example.eater,
    )
    content = repr(words).encode() + half.tobytes()
    return int.from_bytes(hashlib.blake2b(content, digest_size=8).digest())
