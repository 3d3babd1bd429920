from itertools import pairwise

import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3, ring, sphere
from app.vision.solids.sections import cut_sections

SUPPORT_MM = 3.0


def ellipsoid(half_mm, heading=0.0):
    cosine, sine = np.cos(heading), np.sin(heading)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return sphere(20).places * half_mm @ turn.T + [15.0, -40.0, SUPPORT_MM + half_mm[2]], sphere(20).faces


def torus():
    mesh = ring(80, 40)
    turn, tube = mesh.places.T
    radius = 30 + 12 * np.cos(tube)
    vertices = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), 12 * np.sin(tube)])
    return vertices + np.array([5.0, 60.0, SUPPORT_MM + 12.0]), mesh.faces


@pytest.mark.parametrize(
    "solid",
    [ellipsoid((35.0, 35.0, 35.0)), ellipsoid((45.0, 30.0, 20.0), 0.5), torus()],
    ids=["ball", "ellipsoid", "ring"],
)
def test_sections_follow_each_other_and_sum_to_the_volume_of_the_mesh(solid):
    vertices, faces = solid
    found = cut_sections(vertices, faces, SUPPORT_MM)
    # The midpoint rule over a ring's 24 slices leaves 0.3 %: its section grows like a root from the support on.
    assert np.isclose(sum(each.volume_ml for each in found), enclosed_mm3(vertices, faces) / 1000, rtol=5e-3)
    assert found[0].low_mm == 0.0
    assert np.isclose(found[-1].high_mm, np.ptp(vertices[:, 2]))
    assert all(np.isclose(below.high_mm, above.low_mm) for below, above in pairwise(found))
    lifted = cut_sections(vertices, faces, SUPPORT_MM - 10.0)  # the sections lie higher and hold as much
    assert lifted[0].high_mm > 10.0 - 2.0
    assert np.isclose(sum(each.volume_ml for each in lifted), sum(each.volume_ml for each in found), rtol=1e-2)


def test_section_of_an_ellipsoid_has_its_axes_heading_and_centre():
    heading = 0.5
    found = cut_sections(*ellipsoid((45.0, 30.0, 20.0), heading), SUPPORT_MM)
    middle = min(found, key=lambda each: abs(each.low_mm + each.high_mm - 40.0))
    apart = (middle.low_mm + middle.high_mm) / 2 - 20.0
    share = np.sqrt(1 - (apart / 20.0) ** 2)
    assert np.isclose(middle.area_mm2, np.pi * 45 * 30 * share**2, rtol=5e-3)
    assert np.allclose(middle.centre_mm, [15.0, -40.0], atol=0.1)
    assert np.isclose(np.tan(middle.heading), np.tan(heading), atol=0.02)
    # The ratio is that of the outline's second moments, which is a little off the axes'.
    assert np.isclose(middle.half_axes_mm[0] / middle.half_axes_mm[1], 1.5, rtol=0.1)
