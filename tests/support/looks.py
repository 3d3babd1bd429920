"""Vectors of real foods, as the pipeline would describe them: the shipped index keeps only what it compares."""

import numpy as np

from app.identification.food_index import FoodIndex


def vectors_of(index: FoodIndex, food_key: str) -> np.ndarray:
    """(n, d): vectors that the index's metric takes to its examples of a food, n of them."""
    place = next(place for place, food in enumerate(index.foods) if food.food_key == food_key)
    return vectors_at(index, np.flatnonzero(index.labels == place))


def vectors_at(index: FoodIndex, rows: np.ndarray) -> np.ndarray:
    """(n, d): the same of some of its examples."""
    metric = index.metric
    return metric.centre + metric.sd * (index.examples[rows] @ np.linalg.pinv(metric.axes))
