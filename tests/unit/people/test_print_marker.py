"""The printable board: what the PDF's content stream draws, measured in mm."""

import re
import zlib

import numpy as np
import pytest

from app.core.errors import InvalidInputError
from app.people.print_marker import render_marker_pdf
from app.vision.board.marker import find_marker
from app.vision.board.pose import solve_pose
from app.vision.board.print_layout import print_points_mm
from app.vision.marker_spec import COLOUR_SQUARES, parse_marker
from app.vision.model import MarkerObservation
from tests.unit.vision.synthetic import PHONE, look_at
from tests.unit.vision.tag_boards import PX_PER_MM, photograph

MM_PER_POINT = 25.4 / 72


def content(pdf: bytes) -> str:
    """The page's drawing commands."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL)
    return zlib.decompress(streams[0]).decode("latin-1")


def page_mm(pdf: bytes) -> tuple[float, float]:
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert box
    return float(box[1]) * MM_PER_POINT, float(box[2]) * MM_PER_POINT


def squares_mm(pdf: bytes) -> list[tuple[tuple[int, ...], float, float, float, float]]:
    """Filled rectangles: sRGB, then x and y of the upper left corner from the page's, width and height in mm."""
    height = page_mm(pdf)[1]
    colour, found = (0, 0, 0), []  # PDF begins with black
    pattern = r"([\d. ]+) (rg|g)\b|([-\d.]+) ([-\d.]+) ([-\d.]+) ([-\d.]+) re f"
    for grey, operator, *box in re.findall(pattern, content(pdf)):
        if operator:
            levels = [round(float(level) * 255) for level in grey.split()]
            colour = tuple(levels * 3 if operator == "g" else levels)
        else:
            x, y, width, depth = (float(value) * MM_PER_POINT for value in box)
            found.append((colour, x, height - max(y, y + depth), abs(width), abs(depth)))
    return found


def test_plain_board_has_true_size_begins_with_a_dark_square_and_tells_its_name_beside_a_ruler_of_100_mm():
    pdf = render_marker_pdf(parse_marker("plain:10x7:11"))
    squares = squares_mm(pdf)
    assert all(colour == (0, 0, 0) for colour, *_ in squares)
    assert all((width, depth) == pytest.approx((11.0, 11.0), abs=0.01) for *_, width, depth in squares)
    left, top = min(x for _, x, *_ in squares), min(y for _, _, y, *_ in squares)
    across, down = max(x for _, x, *_ in squares) - left, max(y for _, _, y, *_ in squares) - top
    assert (across, down) == (pytest.approx(9 * 11, abs=0.02), pytest.approx(6 * 11, abs=0.02))
    places = {(round((y - top) / 11), round((x - left) / 11)) for _, x, y, *_ in squares}
    assert places == {(r, c) for r in range(7) for c in range(10) if (r + c) % 2 == 0}
    lines = re.findall(r"([\d.]+) ([\d.]+) m ([\d.]+) ([\d.]+) l", content(pdf))
    lengths = [abs(float(x1) - float(x0)) * MM_PER_POINT for x0, _, x1, _ in lines]
    assert max(lengths) == pytest.approx(100.0, abs=0.01)
    assert "plain:10x7:11" in content(pdf)


def test_colour_board_has_its_colours_in_their_places():
    squares = squares_mm(render_marker_pdf(parse_marker("colour:4x5:12")))
    left, top = min(x for _, x, *_ in squares), min(y for _, _, y, *_ in squares)
    drawn = {(round((y - top) / 12), round((x - left) / 12)): colour for colour, x, y, *_ in squares}
    assert drawn == COLOUR_SQUARES


@pytest.mark.parametrize("marker", ["plain:4x4:40", "plain:20x9:12", "colour:4x5:30"])
def test_a_square_of_white_lies_around_the_board(marker):
    spec = parse_marker(marker)
    pdf = render_marker_pdf(spec)
    width, height = page_mm(pdf)
    edges = squares_mm(pdf)
    assert min(min(x, y, width - x - w) for _, x, y, w, _ in edges) >= spec.square_mm - 0.01
    lowest_ink = max(y + d for _, _, y, _, d in edges)
    lines_y = [height - float(y) * MM_PER_POINT for y in re.findall(r"[\d.]+ ([\d.]+) m [\d.]+ [\d.]+ l", content(pdf))]
    assert lines_y
    assert min(lines_y) - lowest_ink >= spec.square_mm - 0.01


@pytest.mark.parametrize(
    ("marker", "page"),
    [
        ("plain:9x7:11", (210, 297)),
        ("plain:20x9:12", (297, 210)),
        ("plain:10x6:27", (420, 297)),
        ("plain:6x10:27", (297, 420)),
    ],
)
def test_smallest_sheet_that_fits_is_chosen(marker, page):
    assert page_mm(render_marker_pdf(parse_marker(marker))) == pytest.approx(page, abs=0.02)


def test_board_larger_than_a3_is_refused():
    with pytest.raises(InvalidInputError) as refused:
        render_marker_pdf(parse_marker("plain:20x20:30"))
    assert refused.value.code == "marker_too_large"


@pytest.mark.parametrize("marker", ["aruco:4x3:20:5:DICT_4X4_50", "charuco:6x6:20:14:DICT_6X6_250"])
def test_printed_board_of_tags_has_its_margin_and_is_found_again_at_its_scale(marker):
    spec = parse_marker(marker)
    pdf = render_marker_pdf(spec)
    shapes = squares_mm(pdf)
    assert min(min(x, y, page_mm(pdf)[0] - x - w) for _, x, y, w, _ in shapes) >= spec.margin_mm - 0.01
    assert marker in content(pdf)
    left, top = (min(shape[axis] for shape in shapes) for axis in (1, 2))
    reach = spec.margin_mm
    width, height = (round((side + 2 * reach) * PX_PER_MM) for side in (spec.width_mm, spec.height_mm))
    picture = np.full((height, width), 255, np.uint8)
    for colour, x, y, across, down in shapes:
        edges = np.array([y - top, y - top + down, x - left, x - left + across]) + reach
        y0, y1, x0, x1 = np.rint(edges * PX_PER_MM).astype(int)
        picture[y0:y1, x0:x1] = colour[0]
    pose = look_at(elevation_deg=60.0, azimuth_deg=-80.0, distance_mm=380.0)
    seen = find_marker(photograph(spec, pose, picture=picture), spec)
    assert isinstance(seen, MarkerObservation), seen
    assert len(seen.corners_px) == len(print_points_mm(spec))
    solved = solve_pose(PHONE, seen)
    assert solved is not None
    # Drawn to a tenth of a millimetre; its corners tell the distance to a thousandth and less.
    assert np.linalg.norm(solved[1]) == pytest.approx(380.0, rel=2e-3)
