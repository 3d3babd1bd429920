import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3
from app.vision.geometry.slices import Slice
from app.vision.geometry.solids import stack_of_slices, turned
from tests.unit.vision.meshes import assert_watertight


def disc(low, high, half_axes, heading=0.0, centre=(10.0, -5.0)):
    return Slice(low, high, np.array(centre), half_axes, heading, 0.0, "fitted")


def test_stack_holds_what_its_slices_sum_to_however_they_are_turned():
    slices = [disc(0, 2, (30, 20)), disc(2, 4, (35, 22), 0.4), disc(4, 7, (12, 3), 2.9, (14.0, -2.0))]
    shape = stack_of_slices(slices)
    assert_watertight(shape.faces)
    held_ml = enclosed_mm3(shape.vertices_mm, shape.faces) / 1000
    assert held_ml == pytest.approx(sum(each.volume_ml for each in slices), rel=1e-9)
    assert (shape.vertices_mm[:, 2].min(), shape.vertices_mm[:, 2].max()) == (0, 7)


def test_gap_in_a_stack_stays_empty():
    slices = [disc(0, 2, (30, 20)), disc(4, 6, (30, 20))]
    shape = stack_of_slices(slices)
    assert_watertight(shape.faces)
    held_ml = enclosed_mm3(shape.vertices_mm, shape.faces) / 1000
    assert held_ml == pytest.approx(sum(each.volume_ml for each in slices), rel=1e-9)


def test_no_slices_make_nothing():
    shape = stack_of_slices([])
    assert shape.vertices_mm.shape == (0, 3)
    assert shape.faces.shape == (0, 3)


@pytest.mark.parametrize("heap_mm", [6.0, 0.0, -4.0])
def test_turned_cone_holds_its_own_volume_and_its_heaps(heap_mm):
    heights = np.linspace(0.0, 30.0, 31)
    shape = turned(np.array([3.0, 4.0]), 20.0 + heights, heights, heap_mm)
    assert_watertight(shape.faces)
    cone = np.pi * 30.0 * (20.0**2 + 20.0 * 50.0 + 50.0**2) / 3
    # Eight rings make a paraboloid's upper side a little flatter.
    assert enclosed_mm3(shape.vertices_mm, shape.faces) == pytest.approx(cone + np.pi * 50.0**2 * heap_mm, rel=0.005)


def test_hollow_does_not_reach_through_the_floor():
    heights = np.linspace(0.0, 10.0, 11)
    shape = turned(np.zeros(2), np.full(11, 30.0), heights, -9.0)
    assert shape.vertices_mm[:, 2].min() == 0.0
    assert shape.vertices_mm[-1, 2] > 0.0
