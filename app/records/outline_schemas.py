"""An outline over the wire: as an app draws it, one ring of corners, or as the server gives it, several rings."""

from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag

from app.http.text_schemas import JsonNumber

MOST_RINGS = 500
MOST_CORNERS = 10_000  # of all rings together: the rings of many merged items too
MIN_CORNERS = 3  # of a ring that encloses something

Pixel = Annotated[JsonNumber, Field(ge=-1e6, le=1e6)]
Corners = Annotated[list[tuple[Pixel, Pixel]], Field(min_length=1)]


def _depth(value: Any) -> str:
    try:
        return "rings" if isinstance(value[0][0], list | tuple) else "ring"
    except (TypeError, IndexError, KeyError):
        return "ring"


def _few_corners(value: Any) -> Any:
    rings = value if _depth(value) == "rings" else [value]
    if sum(len(ring) for ring in rings) > MOST_CORNERS:
        raise ValueError(f"must have at most {MOST_CORNERS} corners in all its rings")
    return value


def _some_area(rings: list[Corners]) -> list[Corners]:
    """Refuse rings that all enclose nothing. Some may: an item's outline is accepted as the server gives it."""
    if all(len(ring) < MIN_CORNERS for ring in rings):
        raise ValueError(f"must have a ring of {MIN_CORNERS} corners or more")
    return rings


Ring = Annotated[list[tuple[Pixel, Pixel]], Field(min_length=MIN_CORNERS, max_length=MOST_CORNERS)]
Rings = Annotated[
    list[Corners], Field(min_length=1, max_length=MOST_RINGS), AfterValidator(_some_area)
]
Polygon = Annotated[
    Annotated[Ring, Tag("ring")] | Annotated[Rings, Tag("rings")],
    Discriminator(_depth),
    AfterValidator(_few_corners),
    Field(
        description="Corners x, y in the left photograph's upright pixels: one ring, or a list of rings as an item's "
        "`polygon` is given, holes by the even-odd rule."
    ),
]
