"""Poses as a phone's tracking gives them, of views whose poses are known."""

import numpy as np

WORLD_FROM_TABLE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # z up -> y up
GL_FROM_CV = np.diag([1.0, -1.0, -1.0])
CLOCKWISE = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # right points down, down points left


def stored_turn(orientation):
    """(3, 3) from the stored picture's axes to the upright one's, both x right, y down, z forwards."""
    return np.linalg.matrix_power(CLOCKWISE, {1: 0, 6: 1, 3: 2, 8: 3}[orientation])


def arkit_poses(left, right, orientations=(1, 1)):
    """The metadata field of two upright views whose stored pictures EXIF turns; the world's y is the table's z."""
    views = {}
    for side, view, orientation in zip(("left", "right"), (left, right), orientations, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = WORLD_FROM_TABLE @ view.rotation.T @ stored_turn(orientation) @ GL_FROM_CV
        pose[:3, 3] = WORLD_FROM_TABLE @ view.centre_mm / 1000
        views[side] = pose.tolist()
    return {"convention": "arkit", "views": views}
