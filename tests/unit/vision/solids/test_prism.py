import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3, face_normals
from app.vision.solids.forms import COARSE, EXACT, FINE
from app.vision.solids.prism import DISPLACEMENT_ORDERS, FREE_SKEW_SD, ROUNDING, ROUNDING_MM, SKEW, prism
from tests.unit.vision.meshes import jacobian_of

RECTANGLE = np.array([[0.0, 0.0], [60.0, 10.0], [50.0, 70.0], [-10.0, 60.0]])  # sides of 10 sqrt(37), at right angles
TRIANGLE = np.array([[0.0, 0.0], [110.0, 0.0], [20.0, 70.0]])
HEIGHT_MM, SUPPORT_MM = 35.0, 2.0
AREA_MM2 = {"block": 3700.0, "wedge": 3850.0}


def begun(name, scale=1.0):
    polygon = {"block": RECTANGLE, "wedge": TRIANGLE}[name]
    return prism(name, scale * polygon, scale * HEIGHT_MM, SUPPORT_MM, 0.5)


def volume(form, unknowns, cells=EXACT):
    return enclosed_mm3(form.vertices(unknowns, cells), form.topology(cells).faces)


@pytest.mark.parametrize("name", ["block", "wedge"])
def test_sharp_prism_has_the_volume_of_its_footprint_times_its_height_and_rests_on_its_support(name):
    form, unknowns = begun(name), begun(name).start
    plain = form.vertices(unknowns, FINE)
    assert np.isclose(plain[:, 2].min(), SUPPORT_MM)
    assert np.isclose(plain[:, 2].max(), SUPPORT_MM + HEIGHT_MM)
    unknowns[-len(DISPLACEMENT_ORDERS) :] = np.random.default_rng(3).normal(0, 0.01, len(DISPLACEMENT_ORDERS))
    moved, low = form.vertices(unknowns, FINE), plain[:, 2] < SUPPORT_MM + 1e-6
    assert np.array_equal(moved[low, 2], plain[low, 2])  # displacement moves walls and top alone
    assert np.abs(moved - plain).max() > 0.3
    unknowns = form.start
    unknowns[ROUNDING] = -20.0  # leaves a tenth of a millimetre
    assert np.isclose(volume(form, unknowns), AREA_MM2[name] * HEIGHT_MM, rtol=1e-3)


def test_rounded_block_lacks_what_its_edges_lack():
    form = begun("block")
    radius, side = ROUNDING_MM + 0.1, np.sqrt(3700.0)
    edges_mm = 4 * (2 * side + HEIGHT_MM)  # a quarter of a square less a quarter of a disc along each
    lacking = (1 - np.pi / 4) * radius**2 * edges_mm
    assert np.isclose(volume(form, form.start), 3700.0 * HEIGHT_MM - lacking, rtol=1e-3)  # corners, chords of arcs


@pytest.mark.parametrize("cells", [COARSE, FINE])
@pytest.mark.parametrize("name", ["block", "wedge"])
def test_all_triangles_of_a_prism_face_outwards(name, cells):
    form = begun(name)
    vertices, mesh = form.vertices(form.start, cells), form.topology(cells)
    normals = face_normals(vertices, mesh.faces)
    apart = vertices[mesh.faces].mean(axis=1) - vertices.mean(axis=0)
    # A triangle without area faces nowhere, and the outline would run along it across the top.
    assert np.einsum("ij,ij->i", normals, apart).min() > 1e-3


@pytest.mark.parametrize("name", ["block", "wedge"])
def test_jacobian_of_a_prism_is_that_of_central_differences(name):
    form, rng = begun(name), np.random.default_rng(1)
    unknowns = form.start + rng.normal(0, 0.01, len(form.start))
    jacobian = jacobian_of(form, unknowns, COARSE)
    for row in range(len(unknowns)):
        step = np.zeros(len(unknowns))
        step[row] = 1e-4
        slope = (form.vertices(unknowns + step, COARSE) - form.vertices(unknowns - step, COARSE)) / 2e-4
        assert np.allclose(jacobian[row], slope, atol=0.02 * max(1.0, np.abs(slope).max()))  # one-sided steps


def test_wedge_is_numbered_so_that_it_is_skewed_least():
    assert all(abs(np.roll(TRIANGLE, turn, axis=0)).max() == 110.0 for turn in range(3))
    skews = [abs(prism("wedge", np.roll(TRIANGLE, turn, axis=0), 30.0, 0.0, 0.5).parameters[SKEW]) for turn in range(3)]
    assert np.allclose(skews, skews[0])
    assert skews[0] < 2 * FREE_SKEW_SD
