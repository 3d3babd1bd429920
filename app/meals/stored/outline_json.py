"""An outline as JSON has it: one ring of corners, or several rings, with holes by the even-odd rule."""

from typing import cast

Ring = list[list[float]]  # corners [x, y], px of the upright photograph
Polygon = Ring | list[Ring]


def rings_of(polygon: Polygon) -> list[Ring]:
    """Return the rings of an outline, whichever of the two forms it has."""
    is_one_ring = bool(polygon) and not isinstance(polygon[0][0], list | tuple)
    return [cast(Ring, polygon)] if is_one_ring else list(cast(list[Ring], polygon))
