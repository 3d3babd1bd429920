"""Made-up classes: a cloud of examples around a middle of its own."""

import numpy as np

MIDDLES = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])


def clouds(counts: tuple[int, ...], spread: float = 0.2, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    labels = np.repeat(np.arange(len(counts)), counts)
    rng = np.random.default_rng(seed)
    return MIDDLES[labels] + rng.normal(0.0, spread, (len(labels), 3)), labels
