"""Homogeneous coordinates, homographies and cross products as matrices."""

import numpy as np

from app.vision.model import Float64Array


def homogeneous(points: Float64Array) -> Float64Array:
    """(n, k) -> (n, k + 1) with a last coordinate of 1."""
    return np.column_stack([points, np.ones(len(points))])


def map_points(homography: Float64Array, points: Float64Array) -> Float64Array:
    """(n, 2) points through a (3, 3) homography -> (n, 2)."""
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def cross_matrix(a: Float64Array) -> Float64Array:
    """Skew-symmetric [a]x of (3,) a (paper, eq. 6): its product with b is the cross product of a and b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
