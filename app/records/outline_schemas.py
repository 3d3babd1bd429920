"""An outline over the wire: as an app draws it, one ring of corners, or as the server gives it, several rings."""

from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag

from app.http.text_schemas import JsonNumber

MOST_RINGS = 100
MOST_CORNERS = 2000  # of all rings together

Pixel = Annotated[JsonNumber, Field(ge=-1e6, le=1e6)]
Ring = Annotated[list[tuple[Pixel, Pixel]], Field(min_length=3, max_length=MOST_CORNERS)]
Rings = Annotated[list[Ring], Field(min_length=1, max_length=MOST_RINGS)]


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


Polygon = Annotated[
    Annotated[Ring, Tag("ring")] | Annotated[Rings, Tag("rings")],
    Discriminator(_depth),
    AfterValidator(_few_corners),
    Field(
        description="Corners x, y in the left photograph's upright pixels: one ring, or a list of rings as an item's "
        "`polygon` is given, holes by the even-odd rule."
    ),
]
