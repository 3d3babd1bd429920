"""Whether decoding photographs takes long, by their structure, which a child reads.

Costly photographs never occupy all children of the API (fair_line.py), so ordinary ones do not wait for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from app.children.api_children import ApiChildren, Whose
from app.photos.inspect import HEIC, PhotoFacts

COSTLY_PIXELS = 200_000_000  # more than a baseline JPEG of 108 megapixels, or a progressive one of 12
HEIC_PASSES = 6  # decoding a pixel of HEVC takes as long as that of 6 pixels of a baseline JPEG
SECONDS = 5.0  # of processor time; reading the structure of 30 MB takes a tenth


@dataclass(frozen=True, slots=True)
class InspectedPhotos:
    """sizes: width and height, px, upright, of the photographs that are whole."""

    sizes: Sequence[tuple[int, int]]
    is_costly: bool


def decoding_pixels(facts: PhotoFacts) -> int:
    """Return how many pixels of a baseline JPEG take as long to decode."""
    return facts.pixels_to_decode * (HEIC_PASSES if facts.media_type == HEIC else facts.scans)


def inspect_in_child(children: ApiChildren, paths: Sequence[Path], whose: Whose) -> InspectedPhotos:
    """Inspect photographs that are decoded together. One that is damaged counts as costly.

    Raises UnavailableError, PhotographError, TadaError (see ApiChildren.run).
    """
    result = children.run("inspect", {"photos": [str(path) for path in paths]}, seconds=SECONDS, whose=whose)
    sizes = [(width, height) for width, height in result["sizes"]]
    return InspectedPhotos(sizes, len(sizes) < len(paths) or result["decoding_pixels"] > COSTLY_PIXELS)
