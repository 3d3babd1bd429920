"""The announced marker: `plain:9x7:11` in -> MarkerSpec out.

Apart from marker.py, which finds it in photographs: who only checks the words (the API) needs neither NumPy nor OpenCV.
"""

import re
from dataclasses import dataclass
from typing import Literal

from app.errors import InvalidInputError

MarkerKind = Literal["plain", "colour"]

MARKER_TEXT = re.compile(r"(plain|colour):(\d{1,3})x(\d{1,3}):(\d{1,4}(?:\.\d{1,4})?)", re.ASCII)
SQUARES_A_SIDE = (4, 40)  # three squares have two corners in a row, too few to tell a board from two crossing lines
SQUARE_MM = (1.0, 200.0)
COLOUR_COLUMNS, COLOUR_ROWS = 4, 5  # of the colour board; which square has which colour: colour_board.py


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """The printed board: squares across and down, their side in mm; written `plain:9x7:11` or `colour:4x5:12`."""

    kind: MarkerKind
    columns: int
    rows: int
    square_mm: float

    def __str__(self) -> str:
        return f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}"


def parse_marker(text: str) -> MarkerSpec:
    """`plain:9x7:11` or `colour:4x5:12`: kind, squares across x down, side in mm.

    Raises InvalidInputError, code "marker_invalid".
    """
    match = MARKER_TEXT.fullmatch(text)
    if match is None:
        raise InvalidInputError(
            f"“{text[:80]}” is no marker: write KIND:COLUMNSxROWS:MM, such as plain:9x7:11 or colour:4x5:12.",
            code="marker_invalid",
        )
    kind: MarkerKind = "plain" if match[1] == "plain" else "colour"
    spec = MarkerSpec(kind, int(match[2]), int(match[3]), float(match[4]))
    fewest, most = SQUARES_A_SIDE
    if not (fewest <= spec.columns <= most and fewest <= spec.rows <= most):
        raise InvalidInputError(
            f"A marker has {fewest} to {most} squares a side, not {spec.columns}x{spec.rows}.", code="marker_invalid"
        )
    if not SQUARE_MM[0] <= spec.square_mm <= SQUARE_MM[1]:
        raise InvalidInputError(
            f"A marker's squares have a side of {SQUARE_MM[0]:g} to {SQUARE_MM[1]:g} mm, not {spec.square_mm:g} mm.",
            code="marker_invalid",
        )
    if spec.kind == "colour" and (spec.columns, spec.rows) != (COLOUR_COLUMNS, COLOUR_ROWS):
        raise InvalidInputError(
            f"The colour board has 4x5 squares, not {spec.columns}x{spec.rows}.", code="marker_invalid"
        )
    return spec
