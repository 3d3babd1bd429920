"""Homogeneous coordinates, homographies, cross products as matrices, and a pinhole's derivatives."""

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


def rotation_along(baseline: Float64Array, forward: Float64Array) -> Float64Array:
    """(3, 3) rotation to a frame with x along the baseline, (3,), and z as near to forward, (3,), as can be."""
    x_axis = baseline / np.linalg.norm(baseline)
    y_axis = np.cross(forward, x_axis)
    y_axis /= np.linalg.norm(y_axis)
    return np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)])


def pixel_gradient(
    points_camera: Float64Array, rotation: Float64Array, focal_px: float
) -> Float64Array:
    """(n, 2, 3) derivative of a pinhole's pixel by the point, px/mm.

    points_camera: (n, 3) mm, camera frame. rotation: (3, 3) from the frame that the derivative is by.
    """
    depth = points_camera[:, 2]
    out = np.empty((len(depth), 2, 3))
    for axis in range(2):
        tilt = (points_camera[:, axis] / depth)[:, None]
        out[:, axis] = (focal_px / depth)[:, None] * (rotation[axis] - tilt * rotation[2])
    return out
