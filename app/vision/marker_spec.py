"""The announced marker: `plain:9x7:11`, `aruco:5x7:35:5:DICT_6X6_250` in -> MarkerSpec out.

board/marker.py finds it in photographs; the API, which only checks the text, needs neither NumPy nor OpenCV.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NoReturn

from app.core.errors import InvalidInputError

DEFAULT_MARKER = "plain:9x7:11"
MarkerKind = Literal["plain", "colour", "aruco", "charuco"]

# Six decimals: what `:g` writes of a side that was computed rather than chosen.
NUMBER = r"\d{1,4}(?:\.\d{1,6})?"
BOARD = rf"(\d{{1,3}})x(\d{{1,3}}):({NUMBER})"
THICK = rf"(?::thick=({NUMBER}))?"
CHECKERBOARD_TEXT = re.compile(rf"(plain|colour):{BOARD}{THICK}", re.ASCII)
TAG_BOARD_TEXT = re.compile(rf"(aruco|charuco):{BOARD}:({NUMBER}):(\w{{1,24}}){THICK}", re.ASCII)
# Three squares have two corners in a row, too few to tell a checkerboard from two crossing lines; tags are named.
SQUARES_A_SIDE: Mapping[MarkerKind, tuple[int, int]] = {
    "plain": (4, 40),
    "colour": (4, 40),
    "aruco": (2, 40),
    "charuco": (3, 40),
}
SQUARE_MM = (1.0, 200.0)
MAX_THICK_MM = 50.0  # a block higher than that hides the meal behind it
COLOUR_COLUMNS, COLOUR_ROWS = (
    4,
    5,
)  # of the colour board; which square has which colour: colour_board.py
# of white around a board of tags, as tada marker prints it; a tag needs one of its cells
TAG_SHEET_MARGIN_MM = 8.0
# OpenCV's predefined dictionaries: how many tags there are, and a tag's bits a side without its black border.
DICTIONARIES: Mapping[str, tuple[int, int]] = {
    **{
        f"DICT_{bits}X{bits}_{tags}": (tags, bits)
        for bits in (4, 5, 6, 7)
        for tags in (50, 100, 250, 1000)
    },
    "DICT_ARUCO_ORIGINAL": (1024, 5),
    "DICT_APRILTAG_16H5": (30, 4),
    "DICT_APRILTAG_25H9": (35, 5),
    "DICT_APRILTAG_36H10": (2320, 6),
    "DICT_APRILTAG_36H11": (587, 6),
    "DICT_ARUCO_MIP_36H12": (250, 6),
}


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """The printed board: squares across and down, their side in mm; written `plain:9x7:11` or `colour:4x5:12`.

    An ArUco grid board's squares are its tags, gap_mm apart: `aruco:5x7:35:5:DICT_6X6_250`. A ChArUco board's light
    squares hold tags of tag_mm: `charuco:6x4:20:14:DICT_4X4_50`. Both are numbered from 0 and placed as OpenCV's
    GridBoard and CharucoBoard do. dictionary, tag_mm: None and 0 for a checkerboard.
    thick_mm: height of the print over the table, `:thick=8.7` for a plaque of 8.7 mm; 0 for a sheet of paper.
    """

    kind: MarkerKind
    columns: int
    rows: int
    square_mm: float
    thick_mm: float = 0.0
    dictionary: str | None = None
    tag_mm: float = 0.0
    gap_mm: float = 0.0

    def __str__(self) -> str:
        tags = ""
        if self.dictionary is not None:
            tags = f":{self.gap_mm if self.kind == 'aruco' else self.tag_mm:g}:{self.dictionary}"
        thick = f":thick={self.thick_mm:g}" if self.thick_mm > 0 else ""
        return f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}{tags}{thick}"

    @property
    def pitch_mm(self) -> float:
        """From one square's left edge to the next one's."""
        return self.square_mm + self.gap_mm

    @property
    def width_mm(self) -> float:
        """Of the print across its columns, without the white margin."""
        return self.columns * self.square_mm + (self.columns - 1) * self.gap_mm

    @property
    def height_mm(self) -> float:
        """Of the print down its rows, without the white margin."""
        return self.rows * self.square_mm + (self.rows - 1) * self.gap_mm

    @property
    def margin_mm(self) -> float:
        """Width of the white margin around the print: a checkerboard's square; a tag's cell or 8 mm."""
        if self.dictionary is None:
            return self.square_mm
        return max(TAG_SHEET_MARGIN_MM, self.tag_mm / (DICTIONARIES[self.dictionary][1] + 2))


def parse_marker(text: str) -> MarkerSpec:
    """`plain:9x7:11`, `colour:4x5:12:thick=3.2`, `aruco:5x7:35:5:DICT_6X6_250` or `charuco:6x4:20:14:DICT_4X4_50`.

    Kind, squares (tags) across x down, side in mm; of ArUco the gap between tags, of ChArUco the tags' side, in mm, and
    the dictionary; thickness in mm. Raises InvalidInputError, code "marker_invalid".
    """
    spec = _read(text)
    fewest, most = SQUARES_A_SIDE[spec.kind]
    squares = "tags" if spec.kind == "aruco" else "squares"
    if not (fewest <= spec.columns <= most and fewest <= spec.rows <= most):
        _refuse(
            f"A marker has {fewest} to {most} {squares} a side, not {spec.columns}x{spec.rows}."
        )
    if not SQUARE_MM[0] <= spec.square_mm <= SQUARE_MM[1]:
        _refuse(
            f"A marker's {squares} have a side of {SQUARE_MM[0]:g} to {SQUARE_MM[1]:g} mm, not {spec.square_mm:g} mm."
        )
    if spec.thick_mm > MAX_THICK_MM:
        _refuse(f"A marker is at most {MAX_THICK_MM:g} mm thick, not {spec.thick_mm:g} mm.")
    if spec.kind == "colour" and (spec.columns, spec.rows) != (COLOUR_COLUMNS, COLOUR_ROWS):
        _refuse(f"The colour board has 4x5 squares, not {spec.columns}x{spec.rows}.")
    if spec.dictionary is not None:
        _check_tags(spec, spec.dictionary)
    return spec


def _read(text: str) -> MarkerSpec:
    match = CHECKERBOARD_TEXT.fullmatch(text)
    if match is not None:
        kind: MarkerKind = "plain" if match[1] == "plain" else "colour"
        return MarkerSpec(
            kind, int(match[2]), int(match[3]), float(match[4]), float(match[5] or 0.0)
        )
    match = TAG_BOARD_TEXT.fullmatch(text)
    if match is None:
        _refuse(
            f"“{text[:80]}” is no marker: write KIND:COLUMNSxROWS:MM, such as plain:9x7:11 or colour:4x5:12, "
            "aruco:COLUMNSxROWS:TAG_MM:GAP_MM:DICTIONARY or charuco:COLUMNSxROWS:SQUARE_MM:TAG_MM:DICTIONARY, such as "
            "aruco:5x7:35:5:DICT_6X6_250; for a plaque add its thickness in mm, such as :thick=8.7."
        )
    columns, rows, square_mm, second_mm = (
        int(match[2]),
        int(match[3]),
        float(match[4]),
        float(match[5]),
    )
    name, thick_mm = match[6].upper(), float(match[7] or 0.0)
    if match[1] == "aruco":
        return MarkerSpec(
            "aruco", columns, rows, square_mm, thick_mm, name, tag_mm=square_mm, gap_mm=second_mm
        )
    return MarkerSpec("charuco", columns, rows, square_mm, thick_mm, name, tag_mm=second_mm)


def _check_tags(spec: MarkerSpec, dictionary: str) -> None:
    if dictionary not in DICTIONARIES:
        _refuse(f"{dictionary} is no dictionary of tags; there are {', '.join(DICTIONARIES)}.")
    tags, bits = DICTIONARIES[dictionary]
    needed = spec.columns * spec.rows // (1 if spec.kind == "aruco" else 2)
    if needed > tags:
        _refuse(
            f"{spec.columns}x{spec.rows} {'tags' if spec.kind == 'aruco' else 'squares'} need {needed} tags, "
            f"{dictionary} has {tags}."
        )
    if spec.kind == "charuco" and not 0 < spec.tag_mm < spec.square_mm:
        _refuse(
            f"A ChArUco board's tags are smaller than its squares of {spec.square_mm:g} mm, "
            f"and larger than nothing: not {spec.tag_mm:g} mm."
        )
    cell_mm = spec.tag_mm / (bits + 2)
    if spec.kind == "aruco" and not cell_mm / 2 <= spec.gap_mm <= SQUARE_MM[1]:
        _refuse(
            f"Tags of {spec.tag_mm:g} mm need a gap of {cell_mm / 2:.2g} to {SQUARE_MM[1]:g} mm of white between them, "
            f"not {spec.gap_mm:g} mm."
        )


def _refuse(message: str) -> NoReturn:
    raise InvalidInputError(message, code="marker_invalid")
