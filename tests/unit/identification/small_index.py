"""A small index of made-up foods: each a cloud of vectors around a middle of its own."""

from collections.abc import Mapping, Sequence

import numpy as np

from app.identification.food_index import FoodIndex, KnownFood
from app.identification.kernel_classifier import Calibration
from tools.food_metric import BlockLayout, fit_metric

LAYOUT = (BlockLayout(6, is_histogram=True, share=0.5), BlockLayout(4, is_histogram=False, share=0.5))
LENGTH = sum(block.size for block in LAYOUT)
LOOKS = ("apple", "bun", "egg", "plum", "tofu", "yam", "kale", "rice")


def pictures_of(look: str, count: int, seed: int = 0, spread: float = 0.05) -> np.ndarray:
    """(count, LENGTH): pictures of what looks so, whether an index knows it or not."""
    place = LOOKS.index(look)
    middle = np.random.default_rng(100 + place).uniform(0.0, 1.0, LENGTH)
    around = np.random.default_rng(1000 * place + seed).normal(0.0, spread, (count, LENGTH))
    vectors = middle + around
    vectors[:, :6] = np.sqrt(np.abs(vectors[:, :6]) / np.abs(vectors[:, :6]).sum(axis=1, keepdims=True))
    return vectors.astype(np.float16).astype(np.float64)  # as an index stores them


def small_index(
    looks: Sequence[str] = LOOKS[:4],
    counts: Sequence[int] = (20, 20, 20, 20),
    volumes_ml: Mapping[str, tuple[float, ...]] | None = None,
) -> FoodIndex:
    vectors = np.concatenate([pictures_of(look, count) for look, count in zip(looks, counts, strict=True)])
    labels = np.repeat(np.arange(len(looks)), counts)
    metric = fit_metric(vectors, LAYOUT)
    return FoodIndex(
        version="made up",
        vcm_version="1",
        foods=tuple(KnownFood(look, look.title(), f"{look}-raw") for look in looks),
        examples=metric.embed(vectors).astype(np.float16).astype(np.float64),
        labels=labels,
        specimens=tuple(f"{looks[label]}{number // 2:03}" for number, label in enumerate(labels)),
        metric=metric,
        calibration=Calibration(0.1, 0.4),
        volumes_ml=volumes_ml or {},
    )
