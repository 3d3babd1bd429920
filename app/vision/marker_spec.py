"""The announced marker: `plain:9x7:11`, `aruco:5x7:35:5:DICT_6X6_250` in -> MarkerSpec out.

A class per kind of board tells what sets it apart: its text, the sizes that it may have, where its squares and tags lie
and what colours they have. All else asks the class. board/marker.py finds boards in photographs; the API, which only
checks the text, needs neither NumPy nor OpenCV.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar, NoReturn, Self

from app.core.errors import InvalidInputError

DEFAULT_MARKER = "plain:9x7:11"
Square = tuple[int, int]  # row and column, from the top left
Colour = tuple[int, int, int]  # sRGB
BLACK: Colour = (0, 0, 0)

# Six decimals: what `:g` writes of a side that was computed rather than chosen.
NUMBER = r"\d{1,4}(?:\.\d{1,6})?"
TEXT = re.compile(
    rf"(?P<kind>[a-z]+):(?P<columns>\d{{1,3}})x(?P<rows>\d{{1,3}}):(?P<square_mm>{NUMBER})"
    rf"(?::(?P<second_mm>{NUMBER}):(?P<dictionary>\w{{1,24}}))?(?::thick=(?P<thick_mm>{NUMBER}))?",
    re.ASCII,
)
MOST_SQUARES = 40  # a side
SQUARE_MM = (1.0, 200.0)
MAX_THICK_MM = 50.0  # a block higher than that hides the meal behind it
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
COLOUR_SQUARES: Mapping[Square, Colour] = {
    (0, 1): (60, 190, 205),
    (0, 3): (225, 60, 45),
    (1, 0): (140, 130, 40),
    (1, 2): (25, 25, 28),
    (2, 1): (215, 85, 165),
    (2, 3): (55, 165, 75),
    (3, 0): (235, 110, 40),
    (3, 2): (165, 35, 45),
    (4, 1): (240, 215, 50),
    (4, 3): (65, 70, 160),
}


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """The printed board, of one of KINDS: squares across and down, and their side in mm.

    kind: its name, with which its text begins
    form: how the text goes on
    usual: those that the page of markers offers
    counted: what a board's columns and rows are of
    fewest: of them a side
    colours: of the squares of a coloured board; the others are white
    points_are_tags: the points that photographs show are the corners of tags, else the inner corners of squares
    thick_mm: height of the print over the table, `:thick=8.7` for a plaque of 8.7 mm; 0 for a sheet of paper
    """

    kind: ClassVar[str]
    form: ClassVar[str]
    usual: ClassVar[tuple[str, ...]]
    counted: ClassVar[str] = "squares"
    fewest: ClassVar[int]
    colours: ClassVar[Mapping[Square, Colour]] = {}
    points_are_tags: ClassVar[bool] = False

    columns: int
    rows: int
    square_mm: float
    thick_mm: float = field(default=0.0, kw_only=True)

    @classmethod
    def of_text(cls, parts: re.Match[str]) -> Self:
        """Read the parts of TEXT."""
        return cls(
            int(parts["columns"]),
            int(parts["rows"]),
            float(parts["square_mm"]),
            thick_mm=float(parts["thick_mm"] or 0.0),
        )

    def __str__(self) -> str:
        thick = f":thick={self.thick_mm:g}" if self.thick_mm > 0 else ""
        return f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}{self.tags_text}{thick}"

    @property
    def tags_text(self) -> str:
        """The part of the text that tells the tags."""
        return ""

    @property
    def gap_mm(self) -> float:
        """White between two squares."""
        return 0.0

    def check(self) -> None:
        """Refuse sizes that no board of the kind has."""
        counted, fewest, most = self.counted, self.fewest, MOST_SQUARES
        if not (fewest <= self.columns <= most and fewest <= self.rows <= most):
            _refuse(
                f"A marker has {fewest} to {most} {counted} a side, not {self.columns}x{self.rows}."
            )
        least_mm, most_mm = SQUARE_MM
        if not least_mm <= self.square_mm <= most_mm:
            _refuse(
                f"A marker's {counted} have a side of {least_mm:g} to {most_mm:g} mm, not {self.square_mm:g} mm."
            )
        if self.thick_mm > MAX_THICK_MM:
            _refuse(f"A marker is at most {MAX_THICK_MM:g} mm thick, not {self.thick_mm:g} mm.")
        self.check_kind()

    def check_kind(self) -> None:
        """Refuse what this kind alone cannot be."""

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
        """Width of the white margin around the print."""
        return self.square_mm

    @property
    def squares(self) -> list[Square]:
        """All squares, row by row."""
        return list(product(range(self.rows), range(self.columns)))

    def square_colour(self, square: Square) -> Colour | None:
        """A square's colour without the tag on it; None if the paper stays white."""
        return BLACK if sum(square) % 2 == 0 else None

    @property
    def is_coloured(self) -> bool:
        """Whether colours can be corrected by the board, not only the white."""
        return bool(self.colours)

    @property
    def first_is_dark(self) -> bool:
        """Whether the upper left square is dark."""
        return self.square_colour((0, 0)) is not None


@dataclass(frozen=True, slots=True)
class PlainBoard(MarkerSpec):
    """A black and white checkerboard: `plain:9x7:11`."""

    kind = "plain"
    form = "COLUMNSxROWS:MM"
    usual = (DEFAULT_MARKER, "plain:9x7:20")
    # three squares have two corners in a row, too few to tell a checkerboard from two crossing lines
    fewest = 4


@dataclass(frozen=True, slots=True)
class ColourBoard(MarkerSpec):
    """The board of ten colours, whose upper left square is white: `colour:4x5:12`."""

    kind = "colour"
    form = "4x5:MM"
    usual = ("colour:4x5:12",)
    fewest = 4
    colours = COLOUR_SQUARES

    def square_colour(self, square: Square) -> Colour | None:
        """One of its colours."""
        return self.colours.get(square)

    def check_kind(self) -> None:
        """It has one size."""
        if (self.columns, self.rows) != (4, 5):
            _refuse(f"The colour board has 4x5 squares, not {self.columns}x{self.rows}.")


@dataclass(frozen=True, slots=True)
class TagBoard(MarkerSpec, ABC):
    """A board with tags of an OpenCV dictionary, numbered from 0, row by row.

    second_mm: the size that stands before the dictionary
    """

    second_mm: float
    dictionary: str

    @classmethod
    def of_text(cls, parts: re.Match[str]) -> Self:
        """Read the tags too."""
        return cls(
            int(parts["columns"]),
            int(parts["rows"]),
            float(parts["square_mm"]),
            float(parts["second_mm"]),
            parts["dictionary"].upper(),
            thick_mm=float(parts["thick_mm"] or 0.0),
        )

    @property
    def tags_text(self) -> str:
        """The second size and the dictionary."""
        return f":{self.second_mm:g}:{self.dictionary}"

    @property
    @abstractmethod
    def tag_mm(self) -> float:
        """A tag's side."""

    @property
    def cells(self) -> int:
        """Of a tag a side, the black border included."""
        return DICTIONARIES[self.dictionary][1] + 2

    @property
    def margin_mm(self) -> float:
        """Of a tag's cell at least."""
        return max(TAG_SHEET_MARGIN_MM, self.tag_mm / self.cells)

    def tag_places(self) -> list[Square]:
        """The square of each tag, by its number."""
        return self.squares

    def legacy_tag_places(self) -> list[Square]:
        """The same as OpenCV before 4.6 placed them."""
        return self.tag_places()

    def check_kind(self) -> None:
        """Refuse a dictionary that is not known or has too few tags, and their size."""
        if self.dictionary not in DICTIONARIES:
            _refuse(
                f"{self.dictionary} is no dictionary of tags; there are {', '.join(DICTIONARIES)}."
            )
        tags, needed = DICTIONARIES[self.dictionary][0], len(self.tag_places())
        if needed > tags:
            _refuse(
                f"{self.columns}x{self.rows} {self.counted} need {needed} tags, "
                f"{self.dictionary} has {tags}."
            )
        self.check_tags()

    def check_tags(self) -> None:
        """Refuse tags that do not fit into the board."""


@dataclass(frozen=True, slots=True)
class ArucoBoard(TagBoard):
    """An ArUco grid board, whose squares are its tags, as OpenCV's GridBoard: `aruco:5x7:35:5:DICT_6X6_250`."""

    kind = "aruco"
    form = "COLUMNSxROWS:TAG_MM:GAP_MM:DICTIONARY"
    usual = ("aruco:4x3:20:5:DICT_4X4_50",)
    counted = "tags"
    fewest = 2
    points_are_tags = True

    @property
    def tag_mm(self) -> float:
        """Of a square, which it is."""
        return self.square_mm

    @property
    def gap_mm(self) -> float:
        """The text's second size."""
        return self.second_mm

    def square_colour(self, square: Square) -> Colour | None:
        """Of a tag, on which its white cells lie."""
        del square
        return BLACK

    def check_tags(self) -> None:
        """Half a cell of white tells one tag from the next."""
        least_mm, most_mm = self.tag_mm / self.cells / 2, SQUARE_MM[1]
        if not least_mm <= self.gap_mm <= most_mm:
            _refuse(
                f"Tags of {self.tag_mm:g} mm need a gap of {least_mm:.2g} to {most_mm:g} mm of white between them, "
                f"not {self.gap_mm:g} mm."
            )


@dataclass(frozen=True, slots=True)
class CharucoBoard(TagBoard):
    """A checkerboard with tags in its light squares, as OpenCV's CharucoBoard: `charuco:6x4:20:14:DICT_4X4_50`."""

    kind = "charuco"
    form = "COLUMNSxROWS:SQUARE_MM:TAG_MM:DICTIONARY"
    usual = ("charuco:8x5:18:13:DICT_4X4_50",)
    fewest = 3

    @property
    def tag_mm(self) -> float:
        """The text's second size."""
        return self.second_mm

    def tag_places(self) -> list[Square]:
        """The light squares."""
        return [square for square in self.squares if sum(square) % 2 == 1]

    def legacy_tag_places(self) -> list[Square]:
        """With an even number of rows the other squares."""
        return [square for square in self.squares if sum(square) % 2 == self.rows % 2]

    def check_tags(self) -> None:
        """A tag lies in its square."""
        if not 0 < self.tag_mm < self.square_mm:
            _refuse(
                f"A ChArUco board's tags are smaller than its squares of {self.square_mm:g} mm, "
                f"and larger than nothing: not {self.tag_mm:g} mm."
            )


KINDS: Mapping[str, type[MarkerSpec]] = {
    kind.kind: kind for kind in (PlainBoard, ColourBoard, ArucoBoard, CharucoBoard)
}
FORMS = tuple(f"{kind.kind}:{kind.form}" for kind in KINDS.values())
USUAL = tuple(marker for kind in KINDS.values() for marker in kind.usual)


def parse_marker(text: str) -> MarkerSpec:
    """Return the board that a text announces: its kind, squares (tags) across x down, side in mm, and what it adds.

    Raises InvalidInputError, code "marker_invalid".
    """
    parts = TEXT.fullmatch(text)
    kind = KINDS.get(parts["kind"]) if parts is not None else None
    if parts is None or kind is None or (parts["dictionary"] is None) == issubclass(kind, TagBoard):
        _refuse(
            f"“{text[:80]}” is no marker: write {', '.join(FORMS)}, such as {DEFAULT_MARKER}; "
            "for a plaque add its thickness in mm, such as :thick=8.7."
        )
    spec = kind.of_text(parts)
    spec.check()
    return spec


def _refuse(message: str) -> NoReturn:
    raise InvalidInputError(message, code="marker_invalid")
