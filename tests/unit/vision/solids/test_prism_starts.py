import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3
from app.vision.solids.form_fit import fit_form
from app.vision.solids.forms import COARSE, EXACT, FINE
from app.vision.solids.prism import ROUNDING, prism
from app.vision.solids.prism_starts import begin_prisms, enclosing_triangle
from app.vision.solids.surface_match import draw_mask
from tests.unit.vision.solids.test_form_fit import MIDDLE_MM, SHAPE, SIGHT, SUPPORT_MM, SUPPORT_SD_MM, seen_of_mesh

RECTANGLE = np.array([[-35.0, -20.0], [35.0, -20.0], [35.0, 20.0], [-35.0, 20.0]])
TRIANGLE = np.array([[-30.0, -30.0], [40.0, -30.0], [-30.0, 40.0]])
HEIGHT_MM = 32.0


def solid(name):
    """A sharp prism turned by half a radian: vertices, mesh, volume in mm3."""
    cosine, sine = np.cos(0.5), np.sin(0.5)
    polygon = {"block": RECTANGLE, "wedge": TRIANGLE}[name] @ np.array([[cosine, sine], [-sine, cosine]]) + MIDDLE_MM
    form = prism(name, polygon, HEIGHT_MM, SUPPORT_MM, SUPPORT_SD_MM)
    unknowns = form.start
    unknowns[ROUNDING] = -20.0
    vertices, mesh = form.vertices(unknowns, EXACT), form.topology(EXACT)
    return vertices, mesh, enclosed_mm3(vertices, mesh.faces)


def mask_of(vertices, mesh):
    return draw_mask(SIGHT.project(vertices)[0], mesh.faces, SHAPE)


def starts(mask, height_mm=HEIGHT_MM):
    return begin_prisms(SIGHT, mask, height_mm, SUPPORT_MM, SUPPORT_SD_MM)


def begun_mm3(form):
    return enclosed_mm3(form.vertices(form.start, EXACT), form.topology(EXACT).faces)


def test_outline_alone_tells_the_height_that_points_got_wrong():
    vertices, mesh, mm3 = solid("block")
    blocks = [each for each in starts(mask_of(vertices, mesh), 1.6 * HEIGHT_MM) if each.name == "block"]
    assert min(abs(begun_mm3(each) / mm3 - 1) for each in blocks) < 0.15  # heights are tried in steps of a tenth


def test_empty_and_hollow_masks_begin_no_prism():
    mask = np.zeros(SHAPE, np.bool_)
    assert starts(mask) == []
    mask[200:300, 300:320] = mask[280:300, 300:420] = True
    assert starts(mask) == []


@pytest.mark.parametrize("name", ["block", "wedge"])
def test_sharp_prism_has_its_volume_from_outlines_and_parallax(name):
    vertices, mesh, mm3 = solid(name)
    seen = seen_of_mesh(vertices, mesh)
    forms = [each for each in starts(seen.mask, 1.1 * HEIGHT_MM) if each.name == name]
    assert len(forms) == 2  # one with the points' height, one with the outline's
    coarse = [fit_form(form, seen, COARSE) for form in forms]
    fits = [fit_form(each.form, seen, FINE, each.unknowns) for each in coarse]
    fit = min(fits, key=lambda each: each.cost)
    # The prior expects 1.5 mm of rounding where there is none.
    assert fit.volume_ml == pytest.approx(mm3 / 1000, rel=0.03)


def test_footprint_with_corners_closer_than_float32_resolves_has_a_triangle():
    far = [(2.66, 41.89), (18.59, 41.92), (26.03, 53.91), (-37.83, 89.3)]
    footprint = np.array([(-48.24666214, 70.49327087), *far, (-48.24663925, 70.49363708)])
    triangle = enclosing_triangle(footprint)
    assert triangle is not None
    following, towards = np.roll(triangle, -1, axis=0) - triangle, footprint[:, None] - triangle
    inside = following[:, 0] * towards[..., 1] - following[:, 1] * towards[..., 0]
    assert inside.min() > -30.0  # mm2: 0.2 mm, by which corners are joined, times the longest side
