"""Sizes of pieces in words -> millilitres: 'slice (5" x 4" x 3/8")' is a box, 'slice (4" dia x 1/8" thick)' a disc.

For the household measures of SR28 that name a piece by its size: with its weight such a piece gives the density of the
food itself. Sizes are nominal and corners are rounded, so it is a rougher figure than a cubic inch.
"""

import math
import re

ML_PER_CUBIC_INCH = 16.387064

_LENGTH = r"(\d+[- ]\d+/\d+|\d+/\d+|\d+\.\d+|\d+)"
_INCH = r'\s*(?:"|in\.)?\s*'
_BOX = re.compile(
    _LENGTH + _INCH + "x" + r"\s*" + _LENGTH + _INCH + "x" + r"\s*" + _LENGTH + r'\s*(?:"|in\.)'
)
_SQUARE = re.compile(_LENGTH + _INCH + r"sq\s*x\s*" + _LENGTH + r'\s*"')
_DISC = re.compile(_LENGTH + _INCH + r"dia\.?,?\s*(?:x\s*)?" + _LENGTH + r'\s*(?:"|in\.)')


def piece_volume_ml(measure: str) -> float | None:
    """The volume of the piece that a measure names by its size; None where it gives no full size."""
    if box := _BOX.search(measure):
        return ML_PER_CUBIC_INCH * _inches(box[1]) * _inches(box[2]) * _inches(box[3])
    if square := _SQUARE.search(measure):
        return ML_PER_CUBIC_INCH * _inches(square[1]) ** 2 * _inches(square[2])
    if disc := _DISC.search(measure):
        return ML_PER_CUBIC_INCH * math.pi / 4.0 * _inches(disc[1]) ** 2 * _inches(disc[2])
    return None


def _inches(words: str) -> float:
    """'3-1/2' -> 3.5."""
    total = 0.0
    for part in re.split(r"[- ]", words):
        numerator, _, denominator = part.partition("/")
        total += float(numerator) / float(denominator or 1.0)
    return total
