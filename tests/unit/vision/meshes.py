"""What holds of every closed mesh."""

import numpy as np


def assert_watertight(faces):
    """Each edge of (m, 3) triangles is run along once in either direction."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {tuple(edge) for edge in directed.tolist()}
    assert len(there) == len(directed), "an edge is run along twice in one direction"
    assert there == {(b, a) for a, b in there}, "an edge has a triangle on one side only"
