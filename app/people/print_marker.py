"""The printable board: a PDF at true size, with a ruler to check the print."""

from collections.abc import Iterator
from itertools import groupby

from fpdf import FPDF

from app.core.errors import InvalidInputError
from app.vision.marker_spec import BLACK, Colour, MarkerSpec, TagBoard

PAPERS_MM = {"A4": (210.0, 297.0), "A3": (297.0, 420.0)}  # width, height, upright
PRINTABLE_MARGIN_MM = 6.0  # what most office printers leave white
RULER_MM = 100.0
FOOTER_MM = 30.0  # ruler and text
# x, y of the upper left corner from the print's, width, height
Rectangle = tuple[float, float, float, float, Colour]
WHITE: Colour = (255, 255, 255)
INSTRUCTION = (
    'Print at 100 % ("actual size"). Check that the ruler is 100 mm long. '
    "Keep the sheet flat and its margin white."
)


def render_marker_pdf(spec: MarkerSpec) -> bytes:
    """Draw one page with the board in its middle as vectors, with at least its own white margin.

    The page is A4, or A3 if the board needs it, upright or turned. Raises InvalidInputError
    (`marker_too_large`).
    """
    page_mm = _page_mm(spec)
    pdf = FPDF(unit="mm", format=page_mm)
    pdf.set_auto_page_break(False)
    pdf.set_margin(0)
    pdf.set_title(f"Marker {spec}")
    pdf.add_page()
    left = (page_mm[0] - spec.width_mm) / 2
    top = max(spec.margin_mm, PRINTABLE_MARGIN_MM)
    for x, y, width, height, colour in [*_squares(spec), *_tags(spec)]:
        pdf.set_fill_color(*colour)
        pdf.rect(left + x, top + y, width, height, style="F")
    _draw_footer(pdf, spec, page_mm)
    return bytes(pdf.output())


def _page_mm(spec: MarkerSpec) -> tuple[float, float]:
    """Return (width, height) of the smallest sheet that holds board, margins and footer; upright if possible."""
    margin = max(spec.margin_mm, PRINTABLE_MARGIN_MM)
    width = max(spec.width_mm + 2 * margin, RULER_MM + 2 * PRINTABLE_MARGIN_MM)
    height = spec.height_mm + 2 * margin + FOOTER_MM
    for paper in PAPERS_MM.values():
        for page in (paper, paper[::-1]):
            if width <= page[0] and height <= page[1]:
                return page
    raise InvalidInputError(
        f"The marker {spec} needs a sheet of {width:.0f} x {height:.0f} mm, more than A3: "
        "choose fewer or smaller squares.",
        code="marker_too_large",
    )


def _squares(spec: MarkerSpec) -> Iterator[Rectangle]:
    """Yield the dark and coloured squares; of an ArUco board the black of its tags."""
    for row, column in spec.squares:
        colour = spec.square_colour((row, column))
        if colour is not None:
            left, top = column * spec.pitch_mm, row * spec.pitch_mm
            yield left, top, spec.square_mm, spec.square_mm, colour


def _tags(spec: MarkerSpec) -> Iterator[Rectangle]:
    """Yield each tag's black square and, on it, its white cells row by row."""
    if not isinstance(spec, TagBoard):
        return
    # Imported here: OpenCV, which the API process does not need for checkerboards.
    from app.vision.board.tag_bits import black_cells  # noqa: PLC0415

    inset_mm = (spec.square_mm - spec.tag_mm) / 2
    for tag, (row, column) in enumerate(spec.tag_places()):
        is_black = black_cells(spec.dictionary, tag).tolist()
        left, top = column * spec.pitch_mm + inset_mm, row * spec.pitch_mm + inset_mm
        yield left, top, spec.tag_mm, spec.tag_mm, BLACK
        cell_mm = spec.tag_mm / len(is_black)
        for down, cells in enumerate(is_black):
            start = 0
            for black, run in groupby(cells):
                count = len(list(run))
                if not black:
                    yield (
                        left + start * cell_mm,
                        top + down * cell_mm,
                        count * cell_mm,
                        cell_mm,
                        WHITE,
                    )
                start += count


def _draw_footer(pdf: FPDF, spec: MarkerSpec, page_mm: tuple[float, float]) -> None:
    """Draw a ruler of 100 mm with a tick every 10 mm, the marker's name and instructions at the lower edge."""
    left = (page_mm[0] - RULER_MM) / 2
    baseline = page_mm[1] - PRINTABLE_MARGIN_MM - 14
    pdf.set_draw_color(*BLACK)
    pdf.set_line_width(0.2)
    pdf.line(left, baseline, left + RULER_MM, baseline)
    for tick in range(0, int(RULER_MM) + 1, 10):
        pdf.line(left + tick, baseline - (4 if tick % 50 == 0 else 2), left + tick, baseline)
    pdf.set_text_color(*BLACK)
    pdf.set_font("Helvetica", size=7)
    pdf.text(left + RULER_MM + 2, baseline, "100 mm")
    size = f"{spec.counted} of {spec.square_mm:g} mm"
    for line, text in enumerate((f"{spec}  ({size})", INSTRUCTION)):
        pdf.text((page_mm[0] - pdf.get_string_width(text)) / 2, baseline + 5 + 4 * line, text)
