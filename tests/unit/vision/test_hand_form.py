import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3, sphere, stacked_loops
from app.vision.hand_form import hand_form_ml

SECTIONS = ("slab", "prism", "ellipsoid")


@pytest.mark.parametrize(("section", "volume_ml"), [("slab", 180.0), ("prism", 141.371669), ("ellipsoid", 94.247780)])
def test_volumes_are_those_of_box_elliptic_prism_and_ellipsoid(section, volume_ml):
    assert hand_form_ml(section, 100.0, 60.0, 30.0) == pytest.approx(volume_ml, rel=1e-7)
    assert hand_form_ml(section, 200.0, 120.0, 60.0) == pytest.approx(8 * volume_ml, rel=1e-7)


@pytest.mark.parametrize("lean_deg", [0.0, -25.0])
@pytest.mark.parametrize("section", SECTIONS)
def test_volume_is_what_a_mesh_of_the_leaning_form_encloses(section, lean_deg):
    vertices, faces = upright(section, 96.0, 57.0, 31.0)
    vertices[:, 0] += vertices[:, 2] * np.tan(np.deg2rad(lean_deg))
    # 96 corners on an ellipse enclose 0.07 % less than it does
    assert hand_form_ml(section, 96.0, 57.0, 31.0) == pytest.approx(enclosed_mm3(vertices, faces) / 1000, rel=2e-3)


def upright(section, length_mm, width_mm, height_mm):
    """Vertices (n, 3) and faces of the form that stands on z = 0."""
    half = np.array([length_mm, width_mm, height_mm]) / 2
    if section == "ellipsoid":
        mesh = sphere(48)
        return (mesh.places + np.array([0.0, 0.0, 1.0])) * half, mesh.faces
    corners = 4 if section == "slab" else 96
    mesh = stacked_loops(2, corners)
    loop, corner = mesh.places.T
    angle = 2 * np.pi * (corner + 0.5) / corners
    radius = np.sqrt(2) if section == "slab" else 1.0
    radius = np.where((loop < 0) | (loop > 1), 0.0, radius)
    places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.clip(loop, 0, 1) * 2])
    return places * half, mesh.faces
