"""Properties of every closed mesh, and the derivatives of a form's vertices."""

import numpy as np


def assert_watertight(faces):
    """Each edge of (m, 3) triangles is run along once in either direction."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {tuple(edge) for edge in directed.tolist()}
    assert len(there) == len(directed), "an edge is run along twice in one direction"
    assert there == {(b, a) for a, b in there}, "an edge has a triangle on one side only"


def jacobian_of(form, unknowns, cells, vertex=None):
    """(k, n, 3) derivatives of all vertices, or of those named, along the three axes."""
    vertex = np.arange(len(form.vertices(unknowns, cells))) if vertex is None else vertex
    along = [form.moves_along(unknowns, cells, vertex, np.tile(axis, (len(vertex), 1))) for axis in np.eye(3)]
    return np.stack(along, axis=2)
