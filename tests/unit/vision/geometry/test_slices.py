import numpy as np
import pytest

from app.vision.geometry.mesh import enclosed_mm3
from app.vision.geometry.slices import Slice, stack_of_slices, turned
from tests.unit.vision.meshes import assert_watertight


def disc(low, high, half_axes, heading=0.0, centre=(10.0, -5.0)):
    return Slice(low, high, np.array(centre), half_axes, heading, 0.0, "fitted")


@pytest.mark.parametrize(
    "slices",
    [
        [disc(0, 2, (30, 20)), disc(2, 4, (35, 22), 0.4), disc(4, 7, (12, 3), 2.9, (14.0, -2.0))],
        [disc(0, 2, (30, 20)), disc(4, 7, (30, 20))],  # a gap stays empty
    ],
)
def test_stack_holds_what_its_slices_sum_to_however_they_are_turned(slices):
    shape = stack_of_slices(slices)
    assert_watertight(shape.faces)
    held_ml = enclosed_mm3(shape.vertices_mm, shape.faces) / 1000
    assert held_ml == pytest.approx(sum(each.volume_ml for each in slices), rel=1e-9)
    assert (shape.vertices_mm[:, 2].min(), shape.vertices_mm[:, 2].max()) == (0, 7)
    nothing = stack_of_slices([])
    assert nothing.vertices_mm.shape == nothing.faces.shape == (0, 3)


@pytest.mark.parametrize("heap_mm", [6.0, 0.0, -4.0])
def test_turned_cone_holds_its_own_volume_and_its_heaps(heap_mm):
    heights = np.linspace(0.0, 30.0, 31)
    shape = turned(np.array([3.0, 4.0]), 20.0 + heights, heights, heap_mm)
    assert_watertight(shape.faces)
    cone = np.pi * 30.0 * (20.0**2 + 20.0 * 50.0 + 50.0**2) / 3
    # Eight rings make a paraboloid's upper side a little flatter.
    assert enclosed_mm3(shape.vertices_mm, shape.faces) == pytest.approx(cone + np.pi * 50.0**2 * heap_mm, rel=0.005)
    low = turned(np.zeros(2), np.full(11, 30.0), np.linspace(0.0, 10.0, 11), -9.0)  # a hollow as deep as the floor
    assert low.vertices_mm[:, 2].min() == 0.0
    assert low.vertices_mm[-1, 2] > 0.0
