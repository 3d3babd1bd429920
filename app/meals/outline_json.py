"""An outline as JSON has it: one ring of corners, or several rings, holes by the even-odd rule."""

from collections.abc import Sequence
from typing import Any

Ring = Sequence[Sequence[float]]


def rings_of(polygon: Sequence[Any]) -> list[Ring]:
    """The rings of an outline, whichever of the two ways it is written in."""
    return [polygon] if polygon and not isinstance(polygon[0][0], list | tuple) else list(polygon)
