"""A frustum's floor and capacity from a level: against frusta whose volumes are computed from their radii."""

import math

import pytest

from app.core.errors import InvalidInputError
from app.vision.vessel_frustum import capacity_from_fill_line, frustum_floor_mm, profile_capacity_ml


def volume_ml(floor_mm, rim_mm, height_mm, level_mm):
    """By thin slices, apart from the closed form under test."""
    steps = 20_000
    step_mm = level_mm / steps
    radii = (floor_mm + (rim_mm - floor_mm) * (i + 0.5) * step_mm / height_mm for i in range(steps))
    return sum(math.pi * radius**2 * step_mm for radius in radii) / 1000.0


@pytest.mark.parametrize(("floor_mm", "rim_mm"), [(30.0, 41.0), (41.0, 41.0), (45.0, 38.0), (0.5, 60.0)])
@pytest.mark.parametrize("level_mm", [40.0, 95.0])
def test_fill_line_of_a_frustum_gives_its_floor_and_capacity(floor_mm, rim_mm, level_mm):
    line_ml = volume_ml(floor_mm, rim_mm, 95.0, level_mm)
    floor = frustum_floor_mm(rim_diameter_mm=2 * rim_mm, height_mm=95.0, level_mm=level_mm, volume_ml=line_ml)
    assert floor == pytest.approx(floor_mm, abs=1e-3)  # the slices' own error
    capacity_ml = capacity_from_fill_line(
        rim_diameter_mm=2 * rim_mm, height_mm=95.0, fill_line_mm=level_mm, fill_line_ml=line_ml
    )
    assert capacity_ml == pytest.approx(volume_ml(floor_mm, rim_mm, 95.0, 95.0), rel=1e-5)


@pytest.mark.parametrize(("level_mm", "line_ml"), [(96.0, 300.0), (0.0, 300.0), (90.0, 20.0)])
def test_line_above_the_brim_or_less_than_a_cone_is_refused(level_mm, line_ml):
    with pytest.raises(InvalidInputError) as error:
        capacity_from_fill_line(rim_diameter_mm=82.0, height_mm=95.0, fill_line_mm=level_mm, fill_line_ml=line_ml)
    assert error.value.code == "vessel_impossible"


def test_profile_of_a_half_ball_holds_two_thirds_of_its_cylinder():
    angles = [math.pi / 2 * step / 500 for step in range(501)]
    profile_mm = [(60.0 * math.sin(angle), 60.0 - 60.0 * math.cos(angle)) for angle in angles]
    assert profile_capacity_ml(profile_mm) == pytest.approx(2 / 3 * math.pi * 60.0**3 / 1000.0, rel=1e-5)
