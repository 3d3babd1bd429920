import numpy as np

from app.vision.geometry.mesh import sphere, unit, vertex_normals
from app.vision.solids.contour import contour_generator

CAMERA_MM = np.array([120.0, -260.0, 330.0])


def contour_of(vertices, mesh):
    return contour_generator(vertices, unit(vertex_normals(vertices, mesh)), mesh, CAMERA_MM)


def test_contour_of_a_sphere_lies_on_the_sphere_and_on_the_cone_from_the_camera():
    radius, mesh = 20.0, sphere(6)
    contour = contour_of(radius * mesh.places, mesh)
    assert np.abs(np.linalg.norm(contour.points, axis=1) - radius).max() < 0.003 * radius
    sight = unit(contour.points - CAMERA_MM)
    beside = np.linalg.norm(np.cross(sight, CAMERA_MM), axis=1)  # of each line of sight from the middle
    assert np.abs(beside - radius).max() < 0.003 * radius


def test_contour_is_closed_and_has_the_surface_that_is_seen_to_one_side():
    mesh = sphere(6)
    contour = contour_of(20.0 * mesh.places, mesh)
    starts, ends = contour.segments.T
    assert np.array_equal(np.sort(starts), np.arange(len(contour.points)))
    assert np.array_equal(np.sort(ends), np.arange(len(contour.points)))


def test_contour_of_a_box_stays_at_its_edges():
    mesh = sphere(6)
    box = mesh.places / np.abs(mesh.places).max(axis=1, keepdims=True) * [30.0, 20.0, 10.0]
    contour = contour_of(box, mesh)
    on_faces = np.isclose(np.abs(contour.points), [30.0, 20.0, 10.0], atol=0.4).sum(axis=1)
    assert (on_faces >= 2).mean() > 0.95
