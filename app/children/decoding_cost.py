"""Which photographs take a decoder long, by their structure: file -> passes over pixels.

What is costly never holds all children of the API at once (fair_line.py), so ordinary photographs do not wait for it.
"""

from collections.abc import Iterable
from pathlib import Path

from app.core.errors import Failure
from app.photos.inspect import HEIC, inspect_photo

COSTLY_PIXELS = 200_000_000  # a camera's baseline JPEG of 108 megapixels and a progressive one of 12 are below
HEIC_PASSES = 6  # a pixel of HEVC takes a decoder as long as so many of a baseline JPEG


def is_costly(paths: Iterable[Path]) -> bool:
    """Whether decoding these photographs together takes a child long. A damaged file counts as costly.

    Raises OSError if a file cannot be read.
    """
    total = 0
    for path in paths:
        facts = inspect_photo(path)
        if isinstance(facts, Failure):  # sealed before today's limits, most likely
            return True
        total += facts.pixels_to_decode * (HEIC_PASSES if facts.media_type == HEIC else facts.scans)
    return total > COSTLY_PIXELS
