import numpy as np
import pytest

from app.vision.geometry.mesh import (
    enclosed_gradient_mm2,
    enclosed_mm3,
    ring,
    sphere,
)
from tests.unit.vision.meshes import assert_watertight

MIDDLE_MM, TUBE_MM = 30.0, 12.0


def torus(mesh):
    turn, tube = mesh.places.T
    radius = MIDDLE_MM + TUBE_MM * np.cos(tube)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), TUBE_MM * np.sin(tube)])


@pytest.mark.parametrize(
    ("mesh", "holes"),
    [(sphere(6), 0), (sphere(7), 0), (ring(20, 10), 1), (ring(7, 5), 1)],
    ids=["sphere", "odd sphere", "ring", "small ring"],
)
def test_mesh_is_closed_and_has_the_euler_characteristic_of_its_surface(mesh, holes):
    assert len(mesh.places) - len(mesh.edges) + len(mesh.faces) == 2 - 2 * holes
    assert_watertight(mesh.faces)
    for edge, pair in zip(mesh.edges, mesh.edge_faces, strict=True):
        assert pair[0] != pair[1]
        assert all(set(edge) <= set(mesh.faces[face]) for face in pair)


@pytest.mark.parametrize("name", ["sphere", "ring"])
def test_volume_converges_to_the_solids_with_the_square_of_the_resolution(name):
    def solid(cells):
        mesh = sphere(cells) if name == "sphere" else ring(3 * cells, 2 * cells)
        return 20.0 * mesh.places if name == "sphere" else torus(mesh), mesh.faces

    truth_mm3 = 4 / 3 * np.pi * 20.0**3 if name == "sphere" else 2 * np.pi**2 * MIDDLE_MM * TUBE_MM**2
    coarse, fine = (1 - enclosed_mm3(*solid(cells)) / truth_mm3 for cells in (12, 24))
    assert 0 < fine < 0.01  # a mesh whose vertices lie on a round solid is smaller
    assert np.isclose(coarse / fine, 4.0, rtol=0.1)


@pytest.mark.parametrize("mesh", [sphere(4), ring(12, 7)], ids=["sphere", "ring"])
def test_volume_gradient_is_that_of_differences(mesh):
    rng = np.random.default_rng(1)
    vertices = (mesh.places * 20 if mesh.places.shape[1] == 3 else torus(mesh)) + rng.normal(
        0, 0.5, (len(mesh.places), 3)
    )
    move = rng.normal(size=vertices.shape)
    step = 1e-3
    change = enclosed_mm3(vertices + step * move, mesh.faces) - enclosed_mm3(vertices - step * move, mesh.faces)
    assert np.isclose((enclosed_gradient_mm2(vertices, mesh) * move).sum(), change / (2 * step), rtol=1e-6)
