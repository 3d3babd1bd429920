"""When two regions look alike: blocks of unlike features brought to one scale, then one distance.

Measures are standardised, each by itself, and clipped, so that one odd measure cannot make a region
unlike all others. Of what is left the principal axes are kept. All of it was fitted to the
photographs of the index that ships (tools/food_index.py).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]  # (n, d), a region a row

CLIP_SD = 4.0


@dataclass(frozen=True, slots=True)
class Metric:
    """centre, sd: (d,) each; sd is infinite nowhere, 1 in histograms. axes: (d, k), weighed by block."""

    centre: Vectors
    sd: Vectors
    axes: Vectors

    def embed(self, vectors: Vectors) -> Vectors:
        """(n, d) vectors -> (n, k), in which the distance is Euclid's; typical regions are 1 apart.

        NaN is what a region was not described by: there it is as near to one food as to another.
        Raises ValueError for vectors of another length, or with infinite numbers.
        """
        given = np.asarray(vectors, np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.centre):
            raise ValueError(
                f"vectors of {len(self.centre)} numbers each are expected, not {given.shape}"
            )
        if np.isinf(given).any():
            raise ValueError("a vector has a number that is not finite")
        apart = np.nan_to_num((given - self.centre) / self.sd, nan=0.0)
        return np.asarray(np.clip(apart, -CLIP_SD, CLIP_SD) @ self.axes, np.float64)


def squared_distances(a: Vectors, b: Vectors) -> Vectors:
    """(n, m) squared Euclidean distances between the rows of a, (n, d), and b, (m, d)."""
    of_a, of_b = (np.einsum("ij,ij->i", each, each) for each in (a, b))
    return np.asarray(np.maximum(of_a[:, None] + of_b - 2.0 * (a @ b.T), 0.0), np.float64)
