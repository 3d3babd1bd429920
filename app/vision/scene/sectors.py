"""Directions around a place as equal sectors: whether a rim is seen all round, whether something lies on every side."""

import numpy as np
from numpy.typing import NDArray

from app.vision.model import Float32Array, Float64Array


def sector_of(
    x: Float32Array | Float64Array, y: Float32Array | Float64Array, sectors: int
) -> NDArray[np.int64]:
    """Return the sector, 0 to sectors - 1, in which each offset (x, y) from the middle lies."""
    turn = np.arctan2(y, x) / (2 * np.pi) + 1.0
    return (turn * sectors).astype(np.int64) % sectors
