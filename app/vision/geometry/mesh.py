"""Closed triangle meshes of fixed topology, of sphere, ring and stacked loops: normals, volume, the outline.

A form of forms.py moves the vertices; which of them make a triangle never changes.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from app.vision.model import Float64Array, MaskArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Topology:
    """places: (n, k) where each vertex lies on the undeformed surface: unit directions, or two angles of a ring.

    faces: (m, 3) vertices of each triangle, counter-clockwise from outside, stored by columns. edges: (e, 2) each once.
    edge_faces: (e, 2) the triangles on either side, first the one that runs along the edge as it is written. around:
    (3 m,) the triangles around each vertex, vertex after vertex. around_from: (n,) where those of each vertex begin.
    """

    places: Float64Array
    faces: IntArray
    edges: IntArray
    edge_faces: IntArray
    around: IntArray
    around_from: IntArray


@dataclass(frozen=True, slots=True)
class ClosedShape:
    """What a volume was taken of: vertices (n, 3) mm, z from the support; faces (m, 3), see Topology.

    Every edge belongs to two triangles, which run along it in opposite directions.
    """

    vertices_mm: Float64Array
    faces: IntArray


@lru_cache
def sphere(cells: int) -> Topology:
    """The unit sphere by a cube whose sides are grids of cells x cells: its edges and corners are vertices.

    So a form with sharp edges keeps them at every resolution.
    """
    grid = np.tan(np.linspace(-1.0, 1.0, cells + 1) * np.pi / 4)
    u, v = (each.ravel() for each in np.meshgrid(grid, grid, indexing="ij"))
    points, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            side = np.empty((len(u), 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = sign, u, v
            points.append(side)
            faces.append(_grid_faces(cells)[:, :: int(sign)] + (len(points) - 1) * len(u))
    merged, index = np.unique(
        np.round(np.concatenate(points), 9) + 0.0, axis=0, return_inverse=True
    )
    directions = merged / np.linalg.norm(merged, axis=1, keepdims=True)
    return _topology(directions, index.ravel()[np.concatenate(faces)])


@lru_cache
def ring(around: int, across: int) -> Topology:
    """A ring's surface by its two angles: around the ring and around the tube, from outside, upwards."""
    turn, tube = np.meshgrid(np.arange(around) / around, np.arange(across) / across, indexing="ij")
    index = np.arange(around * across).reshape(around, across)
    a, b = index, np.roll(index, -1, axis=0)
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    quads = [each.ravel() for each in (a, b, c, d)]
    faces = np.concatenate(
        [np.column_stack([quads[i] for i in corners]) for corners in ((0, 1, 2), (0, 2, 3))]
    )
    return _topology(2 * np.pi * np.column_stack([turn.ravel(), tube.ravel()]), faces)


@lru_cache
def stacked_loops(loops: int, around: int) -> Topology:
    """Loops of `around` vertices each, one above the other, closed by a vertex below the first and one above the last.

    places: (loops * around + 2, 2) number of the loop and of the vertex in it, counter-clockwise from above, loop by
    loop; the vertices below and above come last, as loops -1 and `loops`.
    """
    index = np.arange(loops * around).reshape(loops, around)
    beside = np.roll(index, -1, axis=1)
    a, b, c, d = (each.ravel() for each in (index[:-1], beside[:-1], beside[1:], index[1:]))
    below, above = np.full(around, loops * around), np.full(around, loops * around + 1)
    triangles = [(a, b, c), (a, c, d), (below, beside[0], index[0]), (above, index[-1], beside[-1])]
    faces = np.concatenate([np.column_stack(each) for each in triangles])
    loop, vertex = np.divmod(np.arange(loops * around), around)
    places = np.concatenate([np.column_stack([loop, vertex]), [[-1, 0], [loops, 0]]]).astype(
        np.float64
    )
    return _topology(places, faces)


def _grid_faces(cells: int) -> IntArray:
    """Two triangles a cell; the diagonals run towards the middle, so that all corners of a cube look alike."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a = i * (cells + 1) + j
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    same = ((i < cells / 2) == (j < cells / 2))[:, None]
    first = np.where(same, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(same, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    return np.concatenate([first, second]).astype(np.int64)


def _topology(places: Float64Array, faces: IntArray) -> Topology:
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    pairs = np.sort(sides, axis=1)
    # Each edge stands twice: first for the triangle that runs along it as it is written.
    order = np.lexsort((sides[:, 0] > sides[:, 1], pairs[:, 1], pairs[:, 0]))
    corners = np.argsort(faces, axis=None, kind="stable")
    around_from = np.searchsorted(faces.ravel()[corners], np.arange(len(places)))
    return Topology(
        places,
        np.asfortranarray(faces),
        pairs[order][::2],
        (order % len(faces)).reshape(-1, 2),
        corners // 3,
        around_from,
    )


def face_normals(vertices: Float64Array, faces: IntArray) -> Float64Array:
    """(m, 3) outward, twice each triangle's area long."""
    a, b, c = (vertices.take(faces[:, corner], axis=0) for corner in range(3))
    return _cross(b - a, c - a)


def vertex_normals(vertices: Float64Array, mesh: Topology) -> Float64Array:
    """(n, 3) sum over the triangles around each vertex of face_normals."""
    return summed_around(face_normals(vertices, mesh.faces), mesh)


def summed_around(of_faces: Float64Array, mesh: Topology) -> Float64Array:
    """(n, k) sum over the triangles around each vertex of what each triangle has, (m, k)."""
    return np.add.reduceat(of_faces.take(mesh.around, axis=0), mesh.around_from)


def _cross(a: Float64Array, b: Float64Array) -> Float64Array:
    """(n, 3) cross products; np.cross takes three times as long."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def unit(vectors: Float64Array) -> Float64Array:
    """(n, k) vectors of length one."""
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))  # np.linalg.norm takes twice as long
    return np.asarray(vectors / np.maximum(length, 1e-12)[:, None], np.float64)


def enclosed_mm3(vertices: Float64Array, faces: IntArray) -> float:
    """Volume by the divergence theorem."""
    a, b, c = (vertices.take(faces[:, corner], axis=0) for corner in range(3))
    return float(np.einsum("ij,ij->", a, _cross(b, c))) / 6


def enclosed_gradient_mm2(vertices: Float64Array, mesh: Topology) -> Float64Array:
    """(n, 3) derivative of the volume by each vertex."""
    return vertex_normals(vertices, mesh) / 6


def faces_towards(vertices: Float64Array, faces: IntArray, camera_mm: Float64Array) -> MaskArray:
    """(m,) whether each triangle turns its outside towards a camera."""
    return normals_towards(face_normals(vertices, faces), vertices[faces[:, 0]], camera_mm)


def normals_towards(
    normals: Float64Array, corners: Float64Array, camera_mm: Float64Array
) -> MaskArray:
    """(m,) the same of triangles whose face_normals are known. corners: (m, 3) any corner of each."""
    return np.asarray(np.einsum("ij,ij->i", normals, corners - camera_mm) < 0, np.bool_)
