"""Estimate from a photograph's structure whether decoding it takes long.

Costly photographs never occupy all children of the API (fair_line.py), so ordinary ones do not wait for them.
"""

from collections.abc import Iterable
from pathlib import Path

from app.core.errors import Failure
from app.photos.inspect import HEIC, inspect_photo

COSTLY_PIXELS = 200_000_000  # more than a baseline JPEG of 108 megapixels, or a progressive one of 12
HEIC_PASSES = 6  # decoding a pixel of HEVC takes as long as that of 6 pixels of a baseline JPEG


def is_costly(paths: Iterable[Path]) -> bool:
    """Whether decoding these photographs together takes long. A damaged file counts as costly.

    Raises OSError if a file cannot be read.
    """
    passes = 0
    for path in paths:
        facts = inspect_photo(path)
        if isinstance(facts, Failure):  # sealed under earlier limits, most likely
            return True
        passes += facts.pixels_to_decode * (HEIC_PASSES if facts.media_type == HEIC else facts.scans)
    return passes > COSTLY_PIXELS
