"""Fits the metric that ships: how much each block of features counts, and along which axes regions differ.

Each block has its share of the distance, however many numbers it has. SHARES were chosen on fruit
of shops, dishes and ECUSTFD, each by photographs held out: from a half to all by the learned
features, first places change by two in a hundred; one photograph a food is best told by nearly all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.identification.metric import CLIP_SD, Metric, Vectors, squared_distances
from app.vision.looks.vcm import BLOCKS, LEARNED

LEARNED_SHARE = 0.75  # of the distance; the other blocks share the rest evenly
MOST_AXES = 256  # 128 tell foods apart a little less, all 1,651 no better
LEAST_SD = 1e-9
SAMPLE = 400  # of examples whose distances are measured


@dataclass(frozen=True, slots=True)
class BlockLayout:
    """A block of the vector: its size; is_histogram: else measures, each in a unit of its own.

    share: of the squared distance.
    """

    size: int
    is_histogram: bool
    share: float


LAYOUT = tuple(
    BlockLayout(
        block.size,
        block.kind == "histogram",
        LEARNED_SHARE if block.name == LEARNED else (1.0 - LEARNED_SHARE) / (len(BLOCKS) - 1),
    )
    for block in BLOCKS
)


def fit_metric(vectors: Vectors, layout: Sequence[BlockLayout] = LAYOUT) -> Metric:
    """Return the metric of some examples, (n, d), n >= 1.

    Raises ValueError if the blocks do not make up the vectors.
    """
    if sum(block.size for block in layout) != vectors.shape[1]:
        raise ValueError(
            f"blocks of {sum(block.size for block in layout)} numbers, vectors of {vectors.shape[1]}"
        )
    is_histogram = np.repeat(
        [block.is_histogram for block in layout], [block.size for block in layout]
    )
    centre, spread = vectors.mean(axis=0), vectors.std(axis=0)
    sd = np.where(is_histogram | (spread <= LEAST_SD), 1.0, spread)
    apart = np.clip((vectors - centre) / sd, -CLIP_SD, CLIP_SD)
    sample = apart[np.linspace(0, len(apart) - 1, min(SAMPLE, len(apart))).astype(int)]
    weights, begins = [], 0
    for block in layout:
        part = sample[:, begins : begins + block.size]
        squares = squared_distances(part, part)[np.triu_indices(len(part), 1)]
        weights.append(np.full(block.size, _weight(squares, block.share)))
        begins += block.size
    weight = np.where(is_histogram | (spread > LEAST_SD), np.concatenate(weights), 0.0)
    axes = weight[:, None] * _principal_axes(apart * weight)
    return Metric(centre, sd, axes.astype(np.float16).astype(np.float64))  # as they are stored


def _weight(squares: Vectors, share: float) -> float:
    """Of a block, by its squared distances: their median, or their mean where most are 0."""
    if squares.size == 0:  # one example: nothing is known of distances
        return float(np.sqrt(share))
    typical = float(np.median(squares))
    if typical <= LEAST_SD:
        typical = float(squares.mean())
    return float(np.sqrt(share / typical)) if typical > LEAST_SD else 0.0


def _principal_axes(scaled: Vectors) -> Vectors:
    """(d, k) of examples, (n, d): those along which they differ most."""
    axes = np.linalg.svd(scaled - scaled.mean(axis=0), full_matrices=False)[2]
    return np.asarray(axes[:MOST_AXES].T, np.float64)
