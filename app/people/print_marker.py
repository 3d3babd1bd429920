"""The printable board: a PDF at true size, with a ruler to check the print."""

from fpdf import FPDF

from app.core.errors import InvalidInputError
from app.vision.board.colour_board import COLOUR_SQUARES
from app.vision.marker_spec import MarkerSpec

PAPERS_MM = {"A4": (210.0, 297.0), "A3": (297.0, 420.0)}  # width, height, upright
PRINTABLE_MARGIN_MM = 6.0  # what most office printers leave white
RULER_MM = 100.0
FOOTER_MM = 30.0  # ruler and text
BLACK = (0, 0, 0)
INSTRUCTION = (
    'Print at 100 % ("actual size"). Check that the ruler is 100 mm long. Keep the sheet flat and its margin white.'
)


def render_marker_pdf(spec: MarkerSpec) -> bytes:
    """Draw one page with the board in its middle, squares as vectors, with a white margin of at least one square.

    The page is A4, or A3 if the board needs it, upright or turned. Raises InvalidInputError (`marker_too_large`).
    """
    page_mm = _page_mm(spec)
    pdf = FPDF(unit="mm", format=page_mm)
    pdf.set_auto_page_break(False)
    pdf.set_margin(0)
    pdf.set_title(f"Marker {spec}")
    pdf.add_page()
    left = (page_mm[0] - spec.columns * spec.square_mm) / 2
    top = max(spec.square_mm, PRINTABLE_MARGIN_MM)
    for row in range(spec.rows):
        for column in range(spec.columns):
            colour = _colour(spec, row, column)
            if colour is not None:
                pdf.set_fill_color(*colour)
                x, y = left + column * spec.square_mm, top + row * spec.square_mm
                pdf.rect(x, y, spec.square_mm, spec.square_mm, style="F")
    _draw_footer(pdf, spec, page_mm)
    return bytes(pdf.output())


def _page_mm(spec: MarkerSpec) -> tuple[float, float]:
    """Return (width, height) of the smallest sheet that fits board, margins and footer; upright if both fit."""
    margin = max(spec.square_mm, PRINTABLE_MARGIN_MM)
    width = max(spec.columns * spec.square_mm + 2 * margin, RULER_MM + 2 * PRINTABLE_MARGIN_MM)
    height = spec.rows * spec.square_mm + 2 * margin + FOOTER_MM
    for paper in PAPERS_MM.values():
        for page in (paper, paper[::-1]):
            if width <= page[0] and height <= page[1]:
                return page
    raise InvalidInputError(
        f"The marker {spec} needs a sheet of {width:.0f} x {height:.0f} mm, more than A3: "
        "choose fewer or smaller squares.",
        code="marker_too_large",
    )


def _colour(spec: MarkerSpec, row: int, column: int) -> tuple[int, int, int] | None:
    """Return the square's sRGB colour; None if the paper stays white."""
    if spec.kind == "colour":
        return COLOUR_SQUARES.get((row, column))
    return BLACK if (row + column) % 2 == 0 else None


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
    for line, text in enumerate((f"{spec}  (squares of {spec.square_mm:g} mm)", INSTRUCTION)):
        pdf.text((page_mm[0] - pdf.get_string_width(text)) / 2, baseline + 5 + 4 * line, text)
