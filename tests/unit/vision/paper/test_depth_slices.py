"""Slices across the depth axis, of solids whose volume is known."""

import numpy as np
import pytest

from app.vision.paper.depth_slices import cut_depth_slices

DEPTH_MM = 400.0


def front_of_ellipsoid(a, b, c, count=40_000, seed=0):
    """Points of the half nearer than DEPTH_MM, half-axes a, b across the depth axis and c along it."""
    offsets = np.random.default_rng(seed).normal(size=(count, 3))
    offsets /= np.linalg.norm(offsets, axis=1, keepdims=True)
    points = offsets * [a, b, c]
    return points[points[:, 2] < 0] + [20.0, -10.0, DEPTH_MM]


def volume_ml(slices):
    return 2 * sum(each.volume_ml for each in slices)


@pytest.mark.parametrize(
    ("axes", "form"), [((30, 30, 30), "ellipse"), ((50, 25, 20), "ellipse"), ((20, 20, 40), "circle")]
)
def test_half_an_ellipsoid_doubled_has_the_whole_one_s_volume(axes, form):
    slices, middle_mm = cut_depth_slices(front_of_ellipsoid(*axes), form)
    # 3 % of the depth are cut off as strays, where the area is greatest; a cell's quantisation adds a per cent.
    assert np.isclose(volume_ml(slices), 4 / 3 * np.pi * np.prod(axes) / 1000, rtol=0.07)
    assert DEPTH_MM - 0.05 * axes[2] < middle_mm <= DEPTH_MM
    assert all(np.allclose(each.centre_mm, [20.0, 10.0], atol=1.5) for each in slices)  # y points up here


def test_ellipse_has_the_solid_s_axes_and_heading():
    points = front_of_ellipsoid(50, 25, 20)
    turn = np.radians(30.0)
    matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points[:, :2] = (points[:, :2] - [20.0, -10.0]) @ matrix
    widest = max(cut_depth_slices(points, "ellipse")[0], key=lambda each: each.area_mm2)
    assert np.isclose(widest.half_axes_mm[0] / widest.half_axes_mm[1], 2.0, rtol=0.05)
    assert np.isclose((widest.heading + turn + np.pi / 2) % np.pi, np.pi / 2, atol=0.05)


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.full((500, 3), 7.0), np.tile([[0.0, 0.0, 1.0]], (59, 1))])
def test_too_few_points_or_no_depth_give_no_slices(points):
    assert cut_depth_slices(points, "ellipse")[0] == []
