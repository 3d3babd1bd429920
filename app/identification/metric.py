"""When two regions look alike: blocks of unlike features brought to one scale, then one distance.

Each block weighs the same, however many numbers it has: its squared distances are divided by their median over the
examples that the metric was made from. Measures are standardised before, each by itself, and clipped, so that one odd
measure cannot make a region unlike all others. What is the same in all examples tells none from another and weighs
nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]  # (n, d), a region a row

CLIP_SD = 4.0
LEAST_SD = 1e-9
SAMPLE = 400  # of examples whose distances are measured


@dataclass(frozen=True, slots=True)
class BlockLayout:
    """A block of the vector: its size; is_histogram: else measures, each in a unit of its own."""

    name: str
    size: int
    is_histogram: bool


@dataclass(frozen=True, slots=True)
class Metric:
    """centre, sd, weight: (d,) each; sd is infinite nowhere, 1 in histograms."""

    centre: Vectors
    sd: Vectors
    weight: Vectors

    def embed(self, vectors: Vectors) -> Vectors:
        """(n, d) vectors -> (n, d), in which the distance is Euclid's; typical regions are 1 apart.

        Raises ValueError for vectors of another length, or that are not finite.
        """
        given = np.asarray(vectors, np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.centre):
            raise ValueError(f"vectors of {len(self.centre)} numbers each are expected, not {given.shape}")
        if not np.isfinite(given).all():
            raise ValueError("a vector has a number that is not finite")
        apart = (given - self.centre) / self.sd
        return np.asarray(np.clip(apart, -CLIP_SD, CLIP_SD) * self.weight, np.float64)


def fit_metric(vectors: Vectors, layout: Sequence[BlockLayout]) -> Metric:
    """The metric of some examples, (n, d), n >= 1. Raises ValueError if the blocks do not make up the vectors."""
    if sum(block.size for block in layout) != vectors.shape[1]:
        raise ValueError(f"blocks of {sum(block.size for block in layout)} numbers, vectors of {vectors.shape[1]}")
    is_histogram = np.repeat([block.is_histogram for block in layout], [block.size for block in layout])
    centre = np.where(is_histogram, 0.0, vectors.mean(axis=0))
    spread = vectors.std(axis=0)
    sd = np.where(is_histogram | (spread <= LEAST_SD), 1.0, spread)
    apart = np.clip((vectors - centre) / sd, -CLIP_SD, CLIP_SD)
    sample = apart[np.linspace(0, len(apart) - 1, min(SAMPLE, len(apart))).astype(int)]
    weights, begins = [], 0
    for block in layout:
        part = sample[:, begins : begins + block.size]
        squares = squared_distances(part, part)[np.triu_indices(len(part), 1)]
        weights.append(np.full(block.size, _weight(squares, len(layout))))
        begins += block.size
    return Metric(centre, sd, np.where(is_histogram | (spread > LEAST_SD), np.concatenate(weights), 0.0))


def _weight(squares: Vectors, blocks: int) -> float:
    """Of a block among so many, by its squared distances: their median, or their mean where most are 0."""
    if squares.size == 0:  # one example: nothing is known of distances
        return float(1.0 / np.sqrt(blocks))
    typical = float(np.median(squares))
    if typical <= LEAST_SD:
        typical = float(squares.mean())
    return float(1.0 / np.sqrt(typical * blocks)) if typical > LEAST_SD else 0.0


def squared_distances(a: Vectors, b: Vectors) -> Vectors:
    """(n, m) squared Euclidean distances between the rows of a, (n, d), and b, (m, d)."""
    squares = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None, :] - 2.0 * (a @ b.T)
    return np.asarray(np.maximum(squares, 0.0), np.float64)
