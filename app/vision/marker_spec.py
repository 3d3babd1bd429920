"""The announced marker: `plain:9x7:11` in -> MarkerSpec out.

board/marker.py finds it in photographs; the API, which only checks the text, needs neither NumPy nor OpenCV.
"""

import re
from dataclasses import dataclass
from typing import Literal

from app.core.errors import InvalidInputError

MarkerKind = Literal["plain", "colour"]

NUMBER = r"\d{1,4}(?:\.\d{1,4})?"
MARKER_TEXT = re.compile(rf"(plain|colour):(\d{{1,3}})x(\d{{1,3}}):({NUMBER})(?::thick=({NUMBER}))?", re.ASCII)
SQUARES_A_SIDE = (4, 40)  # three squares have two corners in a row, too few to tell a board from two crossing lines
SQUARE_MM = (1.0, 200.0)
MAX_THICK_MM = 50.0  # a block higher than that hides the meal behind it
COLOUR_COLUMNS, COLOUR_ROWS = 4, 5  # of the colour board; which square has which colour: colour_board.py


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """The printed board: squares across and down, their side in mm; written `plain:9x7:11` or `colour:4x5:12`.

    thick_mm: height of the print over the table, `:thick=8.7` for a plaque of 8.7 mm; 0 for a sheet of paper.
    """

    kind: MarkerKind
    columns: int
    rows: int
    square_mm: float
    thick_mm: float = 0.0

    def __str__(self) -> str:
        thick = f":thick={self.thick_mm:g}" if self.thick_mm > 0 else ""
        return f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}{thick}"


def parse_marker(text: str) -> MarkerSpec:
    """`plain:9x7:11` or `colour:4x5:12:thick=3.2`: kind, squares across x down, side in mm, thickness in mm.

    Raises InvalidInputError, code "marker_invalid".
    """
    match = MARKER_TEXT.fullmatch(text)
    if match is None:
        raise InvalidInputError(
            f"“{text[:80]}” is no marker: write KIND:COLUMNSxROWS:MM, such as plain:9x7:11 or colour:4x5:12; "
            "for a plaque add its thickness in mm, such as :thick=8.7.",
            code="marker_invalid",
        )
    kind: MarkerKind = "plain" if match[1] == "plain" else "colour"
    spec = MarkerSpec(kind, int(match[2]), int(match[3]), float(match[4]), float(match[5] or 0.0))
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
    if spec.thick_mm > MAX_THICK_MM:
        raise InvalidInputError(
            f"A marker is at most {MAX_THICK_MM:g} mm thick, not {spec.thick_mm:g} mm.", code="marker_invalid"
        )
    if spec.kind == "colour" and (spec.columns, spec.rows) != (COLOUR_COLUMNS, COLOUR_ROWS):
        raise InvalidInputError(
            f"The colour board has 4x5 squares, not {spec.columns}x{spec.rows}.", code="marker_invalid"
        )
    return spec
