"""Fits the metric of an index to its examples.

Each block weighs the same, however many numbers it has: its squared distances are divided by their median over the
examples. What is the same in all examples tells none from another and weighs nothing.
"""

from collections.abc import Sequence

import numpy as np

from app.identification.metric import CLIP_SD, BlockLayout, Metric, Vectors, squared_distances

LEAST_SD = 1e-9
SAMPLE = 400  # of examples whose distances are measured


def fit_metric(vectors: Vectors, layout: Sequence[BlockLayout]) -> Metric:
    """The metric of some examples, (n, d), n >= 1. Raises ValueError if the blocks do not make up the vectors."""
    if sum(block.size for block in layout) != vectors.shape[1]:
        raise ValueError(
            f"blocks of {sum(block.size for block in layout)} numbers, vectors of {vectors.shape[1]}"
        )
    is_histogram = np.repeat(
        [block.is_histogram for block in layout], [block.size for block in layout]
    )
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
    return Metric(
        centre, sd, np.where(is_histogram | (spread > LEAST_SD), np.concatenate(weights), 0.0)
    )


def _weight(squares: Vectors, blocks: int) -> float:
    """Of a block among so many, by its squared distances: their median, or their mean where most are 0."""
    if squares.size == 0:  # one example: nothing is known of distances
        return float(1.0 / np.sqrt(blocks))
    typical = float(np.median(squares))
    if typical <= LEAST_SD:
        typical = float(squares.mean())
    return float(1.0 / np.sqrt(typical * blocks)) if typical > LEAST_SD else 0.0
