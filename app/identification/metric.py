"""When two regions look alike: blocks of unlike features brought to one scale, then one distance.

Measures are standardised, each by itself, and clipped, so that one odd measure cannot make a region
unlike all others. The scale comes with the index (build_index.py fits it).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]  # (n, d), a region a row

CLIP_SD = 4.0


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
            raise ValueError(
                f"vectors of {len(self.centre)} numbers each are expected, not {given.shape}"
            )
        if not np.isfinite(given).all():
            raise ValueError("a vector has a number that is not finite")
        apart = (given - self.centre) / self.sd
        return np.asarray(np.clip(apart, -CLIP_SD, CLIP_SD) * self.weight, np.float64)


def squared_distances(a: Vectors, b: Vectors) -> Vectors:
    """(n, m) squared Euclidean distances between the rows of a, (n, d), and b, (m, d)."""
    squares = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None, :] - 2.0 * (a @ b.T)
    return np.asarray(np.maximum(squares, 0.0), np.float64)
