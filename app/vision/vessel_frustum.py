"""A vessel as frusta: what a profile holds, a floor from what is held up to a level, a capacity from a fill line."""

import math
from collections.abc import Sequence
from itertools import pairwise

from app.core.errors import InvalidInputError


def frustum_floor_mm(
    *, rim_diameter_mm: float, height_mm: float, level_mm: float, volume_ml: float
) -> float | None:
    """Radius of the floor of the frustum with this rim that holds volume_ml up to level_mm over its floor.

    With r = (1 - s) r0 + s R at the level, s = level / height, V = pi level / 3 (r0^2 + r0 r + r^2) is a quadratic in
    the floor's r0. None if no frustum holds so little: one that ends in a point holds more.
    """
    share, rim_mm = level_mm / height_mm, rim_diameter_mm / 2
    rest = 1.0 - share
    a = 1.0 + rest + rest * rest
    b = share * rim_mm * (1.0 + 2.0 * rest)
    c = (share * rim_mm) ** 2 - 3.0 * 1000.0 * volume_ml / (math.pi * level_mm)
    return (-b + math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a) if c <= 0.0 else None


def profile_capacity_ml(profile_mm: Sequence[tuple[float, float]]) -> float:
    """What (radius, height) from the floor up to the brim hold, ml: a frustum between each two points."""
    volumes_mm3 = (
        math.pi / 3.0 * (upper_mm - lower_mm) * (below_mm**2 + below_mm * above_mm + above_mm**2)
        for (below_mm, lower_mm), (above_mm, upper_mm) in pairwise(profile_mm)
    )
    return sum(volumes_mm3) / 1000.0


def capacity_from_fill_line(
    *, rim_diameter_mm: float, height_mm: float, fill_line_mm: float, fill_line_ml: float
) -> float:
    """Capacity to the brim, ml, of the frustum with this rim that holds fill_line_ml up to fill_line_mm over the table.

    The floor's thickness is neglected: it makes the frustum's bottom narrower, and leaves the part between line and
    brim, whose upper radius is measured, nearly as it is. Raises InvalidInputError, code "vessel_impossible", where no
    frustum with this rim holds so little, and where the line is not below the brim.
    """
    if not 0.0 < fill_line_mm <= height_mm:
        raise _impossible(
            f"the fill line must be between the table and the brim, {height_mm:g} mm, not at {fill_line_mm:g} mm."
        )
    floor_mm = frustum_floor_mm(
        rim_diameter_mm=rim_diameter_mm,
        height_mm=height_mm,
        level_mm=fill_line_mm,
        volume_ml=fill_line_ml,
    )
    if floor_mm is None:
        raise _impossible(
            f"one with this rim and height holds more than {fill_line_ml:g} ml up to its fill line."
        )
    rim_mm = rim_diameter_mm / 2
    return math.pi * height_mm / 3.0 * (floor_mm**2 + floor_mm * rim_mm + rim_mm**2) / 1000.0


def _impossible(reason: str) -> InvalidInputError:
    return InvalidInputError(f"No vessel has these measures: {reason}", code="vessel_impossible")
