"""The contour generator of a mesh that stands for a smooth surface: where it turns away from a camera.

Between a vertex that faces the camera and one that does not, the surface is the parabola that touches both tangent
planes. So a contour moves continuously with the vertices, lies on the surface and not within the mesh, and stays at an
edge where there is one: a tangent plane on either side of it meets the other there.
"""

from dataclasses import dataclass

import numpy as np

from app.vision.geometry.mesh import IntArray, Topology, unit
from app.vision.model import Float64Array

FLAT = 0.01  # sine of the angle between a tangent plane and the way to the other vertex, below which they are one


@dataclass(frozen=True, slots=True)
class Contour:
    """points: (n, 3) mm. normals: (n, 3) outward there. vertex: (n, 2) that each lies between, share: (n,) of the way.

    segments: (k, 2) points, one segment in each triangle that the contour crosses; what faces the camera lies to the
    same side of all.
    """

    points: Float64Array
    normals: Float64Array
    vertex: IntArray
    share: Float64Array
    segments: IntArray


def contour_generator(
    vertices: Float64Array, normals: Float64Array, mesh: Topology, camera_mm: Float64Array
) -> Contour:
    """The contour towards a camera (3,). normals: (n, 3) of the vertices, outward, of length one."""
    away = np.einsum("ij,ij->i", normals, vertices - camera_mm)
    is_facing = away < 0
    crossed = np.flatnonzero(is_facing[mesh.edges[:, 0]] != is_facing[mesh.edges[:, 1]])
    edges = mesh.edges[crossed]
    is_first = is_facing[edges[:, 0]]
    edges = np.where(is_first[:, None], edges, edges[:, ::-1])
    near, far = edges.T
    chord = vertices[far] - vertices[near]
    length = np.maximum(np.sqrt(np.einsum("ij,ij->i", chord, chord)), 1e-9)
    falls_near = -np.einsum("ij,ij->i", normals[near], chord) / length
    falls_far = np.einsum("ij,ij->i", normals[far], chord) / length
    reach_near, reach_far = np.abs(falls_far) + FLAT, np.abs(falls_near) + FLAT
    at_near, at_far = reach_near * -away[near], reach_far * away[far]
    along = at_near / np.maximum(at_near + at_far, 1e-12)
    bow = 2 * along * (1 - along)
    share = along**2 + bow * reach_near / (reach_near + reach_far)
    bend = np.maximum(falls_near * falls_far, 0) * np.sign(falls_near)
    height = bow * length * bend / (reach_near + reach_far)
    points = vertices[near] + share[:, None] * chord
    outward = unit(normals[near] + normals[far])
    points += height[:, None] * outward
    # Each crossed triangle has one edge by which its outline leaves what faces the camera, and one by which it returns.
    leaves = np.column_stack([is_first, ~is_first])
    order = np.argsort(2 * mesh.edge_faces[crossed] + leaves, axis=None)
    return Contour(points, outward, edges, share, (order // 2).reshape(-1, 2))
