import numpy as np

from app.vision.geometry.slices import slice_thickness_mm
from app.vision.paper.cut_slices import carve, cut_slices
from app.vision.paper.symmetry import SymmetryAxis
from tests.unit.vision.clouds import PLACE_MM

TOWARDS = np.array([0.0, -1.0])
ROUND = SymmetryAxis(PLACE_MM[:2], 0.0, 1.0)


def wall(shape, low, high, count=40_000, seed=0):
    """Points on a vertical wall whose outline is shape(angles) -> (n, 2)."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([shape(angle), rng.uniform(low, high, count)]) + PLACE_MM


def ellipse(a, b):
    return lambda t: np.column_stack([a * np.cos(t), b * np.sin(t)])


def test_cylinder_slices_have_its_radius():
    slices = cut_slices(wall(ellipse(30.0, 30.0), 0.0, 40.0), 2.0, ROUND, "circle", TOWARDS)
    assert len(slices) == 20
    assert (slice_thickness_mm(10.0), slice_thickness_mm(64.0)) == (1.0, 2.0)
    # Forty-eight chords cut the circle's area short by 0.3 %.
    assert all(abs(each.half_axes_mm[0] / 30.0 - 1) < 0.01 for each in slices)
    assert {each.source for each in slices} == {"fitted"}
    assert np.isclose(sum(each.volume_ml for each in slices), np.pi * 900 * 40 / 1000, rtol=0.015)


def test_ellipse_slices_have_its_axes_and_heading():
    axis = SymmetryAxis(PLACE_MM[:2], 0.0, 1.6)
    slices = cut_slices(wall(ellipse(48.0, 30.0), 0.0, 20.0), 2.0, axis, "ellipse", TOWARDS)
    long, short = slices[5].half_axes_mm
    assert abs(long / 48.0 - 1) < 0.02
    assert abs(short / 30.0 - 1) < 0.02
    assert abs(np.sin(slices[5].heading)) < 0.03


def test_short_arc_is_scaled_from_the_common_shape():
    points = wall(ellipse(30.0, 30.0), 0.0, 20.0)
    front = points[points[:, 1] < PLACE_MM[1] - 22.0]
    slices = cut_slices(front, 2.0, ROUND, "circle", TOWARDS)
    assert {each.source for each in slices} == {"scaled"}
    assert abs(slices[0].half_axes_mm[0] - 30.0) < 0.5


def test_slices_under_the_belly_mirror_those_above():
    height = 60.0
    radius = lambda z: 30.0 * np.sqrt(np.clip(1 - (z / 30.0 - 1) ** 2, 0, 1))  # noqa: E731
    points = wall(ellipse(1.0, 1.0), 20.0, height, 200_000) - PLACE_MM
    points[:, :2] *= radius(points[:, 2])[:, None]
    slices = cut_slices(points + PLACE_MM, 2.0, ROUND, "circle", TOWARDS)
    assert slices[0].low_mm == 0.0
    assert {each.source for each in slices[:10]} == {"mirrored"}
    # The outline of a slice two millimetres thick is that of its wider side, and the mirror may be off by one.
    assert abs(sum(each.volume_ml for each in slices) / (4 / 3 * np.pi * 27) - 1) < 0.05


def test_wall_that_starts_above_the_support_is_continued_down():
    slices = cut_slices(wall(ellipse(30.0, 30.0), 10.0, 12.0), 2.0, ROUND, "circle", TOWARDS)
    assert [each.source for each in slices[:5]] == ["continued"] * 5


def test_carving_halves_what_reaches_half_out_of_the_outline():
    slices = cut_slices(wall(ellipse(30.0, 30.0), 0.0, 20.0), 2.0, ROUND, "circle", TOWARDS)
    carved = carve(slices, lambda points: points[:, 0] > PLACE_MM[0])
    assert np.isclose(carved[0].volume_ml / slices[0].volume_ml, 0.5, rtol=0.02)
    assert carved[0].centre_mm[0] > PLACE_MM[0] + 10.0
    assert carve(slices, lambda points: np.ones(len(points), bool)) == slices  # what lies inside stays
