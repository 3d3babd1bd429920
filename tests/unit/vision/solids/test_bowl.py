"""What fills bowls of known profile: caps of spheres, cylinders and cones, with levels and heaps that are known."""

import numpy as np
import pytest

from app.core.units import ml_from_mm3
from app.vision.geometry.mesh import enclosed_mm3
from app.vision.scene.vessel import Vessel
from app.vision.solids.bowl import BowlContent, measure_content
from app.vision.solids.measured_item import NORMAL_90
from tests.unit.vision.meshes import assert_watertight

CENTRE_MM = np.array([100.0, 40.0])
TABLE_MM = 2.0  # of the table over the marker's plane, which heights of a vessel count from and points do not
WALL_MM = 4.0  # thickness
FLOOR_MM, FLOOR_SD_MM = 6.0, 1.0


class Bowl:
    """A wall around CENTRE_MM: inner radius at a height over the table; the rim's height; the foot."""

    def __init__(self, inner_radius_mm, rim_mm=60.0):
        self.inner_radius_mm = inner_radius_mm
        self.rim_mm = rim_mm

    def volume_ml(self, level_mm):
        """The independent truth: discs of a hundredth of a millimetre."""
        heights = np.arange(FLOOR_MM, level_mm, 0.01) + 0.005
        return ml_from_mm3(float(np.pi * (self.inner_radius_mm(heights) ** 2).sum() * 0.01))

    def vessel(self, seen_share=0.9):
        """Its description with the outer wall seen from the rim down to this share of its height."""
        heights = np.arange(self.rim_mm * (1.0 - seen_share), self.rim_mm - 4.0, 4.0)
        wall = np.column_stack([heights + TABLE_MM, self.inner_radius_mm(heights) + WALL_MM])
        return Vessel(
            CENTRE_MM, float(self.inner_radius_mm(self.rim_mm) + WALL_MM), self.rim_mm + TABLE_MM, wall[heights > 0]
        )

    def top(self, level_mm, heap_mm=0.0, step_mm=1.5, noise_mm=0.3):
        """Points of the content's top, over the table: level at the wall, a paraboloid of this height on it."""
        edge = float(self.inner_radius_mm(level_mm))
        x, y = np.meshgrid(np.arange(-edge, edge, step_mm), np.arange(-edge, edge, step_mm))
        radius = np.hypot(x, y).ravel()
        inside = radius < edge
        z = level_mm + heap_mm * (1.0 - (radius / edge) ** 2)
        z += np.random.default_rng(1).normal(0.0, noise_mm, len(z))
        return np.column_stack([x.ravel() + CENTRE_MM[0], y.ravel() + CENTRE_MM[1], z])[inside]


def spherical(radius_mm=80.0, rim_mm=60.0):
    """Inside a sphere whose lowest point is the floor."""
    return Bowl(lambda z: np.sqrt(np.maximum(radius_mm**2 - (radius_mm - (z - FLOOR_MM)) ** 2, 0.0)), rim_mm)


def straight(radius_mm=60.0):
    return Bowl(lambda z: np.full_like(np.asarray(z, float), radius_mm))


def conical(foot_mm=30.0, rim_radius_mm=70.0, rim_mm=60.0):
    return Bowl(lambda z: foot_mm + (rim_radius_mm - foot_mm) * np.asarray(z) / rim_mm)


def measured(bowl, points, seen_share=0.9, floor_sd_mm=FLOOR_SD_MM) -> BowlContent | None:
    before = points.copy()
    content = measure_content(points, bowl.vessel(seen_share), TABLE_MM, FLOOR_MM, floor_sd_mm)
    assert np.array_equal(points, before)
    return content


def is_in_interval(found, true_ml):
    """90 %, log-normal, as shape.py makes intervals."""
    return abs(np.log(found.volume_ml / true_ml)) < NORMAL_90 * found.sd_ml / found.volume_ml


BOWLS = {"spherical": spherical(), "straight": straight(), "conical": conical()}


@pytest.mark.parametrize("level_mm", [25.0, 52.0])
@pytest.mark.parametrize("name", BOWLS)
def test_content_of_a_known_bowl_is_within_its_interval(name, level_mm):
    bowl = BOWLS[name]
    found = measured(bowl, bowl.top(level_mm))
    assert is_in_interval(found, bowl.volume_ml(level_mm))


def test_heap_counts_by_its_mean_height():
    bowl = straight()
    flat, heaped = (measured(bowl, bowl.top(40.0, heap_mm=heap)) for heap in (0.0, 12.0))
    heap_ml = ml_from_mm3(np.pi * 60.0**2 * 12.0 / 2)  # a paraboloid has half its cylinder
    assert heaped.volume_ml - flat.volume_ml == pytest.approx(heap_ml, rel=0.15)  # its foot lifts the level at the wall


def test_unseen_wall_and_uncertain_floor_make_the_doubt_grow():
    bowl = conical()
    seen, unseen = (measured(bowl, bowl.top(45.0), seen_share=share) for share in (0.9, 0.0))
    assert unseen.sd_ml > 1.3 * seen.sd_ml
    assert is_in_interval(unseen, bowl.volume_ml(45.0))
    bowl = straight()
    sure, unsure = (measured(bowl, bowl.top(45.0), floor_sd_mm=sd) for sd in (0.0, 8.0))
    assert unsure.volume_ml == sure.volume_ml
    assert unsure.sd_ml**2 - sure.sd_ml**2 == pytest.approx((ml_from_mm3(np.pi * 60.0**2) * 8.0) ** 2, rel=0.3)


@pytest.mark.parametrize("heap_mm", [0.0, 12.0])
@pytest.mark.parametrize("name", BOWLS)
def test_shape_is_closed_and_holds_the_volume(name, heap_mm):
    bowl = BOWLS[name]
    found = measured(bowl, bowl.top(40.0, heap_mm=heap_mm))
    assert_watertight(found.shape.faces)
    held_ml = ml_from_mm3(enclosed_mm3(found.shape.vertices_mm, found.shape.faces))
    assert held_ml == pytest.approx(found.volume_ml, rel=0.01)  # steps of 1 mm, and of the vault's rings
    assert found.slices[0].low_mm == 0.0
    assert all(np.array_equal(each.centre_mm, CENTRE_MM) for each in found.slices)
    if heap_mm == 0.0:
        assert found.slices[-1].high_mm == pytest.approx(40.0 - FLOOR_MM, abs=0.5)  # the level, as it was measured


def test_too_few_points_are_no_measurement_and_those_beyond_the_rim_do_not_count():
    bowl = straight()
    outside = bowl.top(40.0) + np.array([200.0, 0.0, 0.0])
    assert measured(bowl, outside) is None
    assert measured(bowl, bowl.top(40.0)[:20]) is None
    both = np.concatenate([bowl.top(40.0), outside])
    assert measured(bowl, both).volume_ml == measured(bowl, bowl.top(40.0)).volume_ml
