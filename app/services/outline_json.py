"""An outline as JSON has it: one ring of corners, or several rings, holes by the even-odd rule."""

from collections.abc import Sequence
from typing import Any

Ring = Sequence[Sequence[float]]


def rings_of(polygon: Sequence[Any]) -> list[Ring]:
    """The rings of an outline, whichever of the two ways it is written in; of an empty one, one empty ring."""
    return list(polygon) if polygon and isinstance(polygon[0][0], list | tuple) else [polygon]
