"""What the board's colours bring about, on boards whose colours are known."""

import cv2
import numpy as np
import pytest

from app.vision.board.ciede2000 import ciede2000
from app.vision.board.colour_correction import apply_colour, measure_colour
from app.vision.board.colour_fit import PAPER_WHITE, reference_linear
from app.vision.board.colour_space import LINEAR_OF_BYTE, encode_srgb, lab_of, linear_rgb
from app.vision.marker_spec import COLOUR_SQUARES
from app.vision.model import ColourCorrection, MarkerObservation, Photo
from tests.unit.vision.boards import COLOUR, PLAIN, board_photo, places, printed_colours

PHONE = np.array([[0.62, 0.12, 0.02], [0.05, 0.60, 0.06], [0.01, 0.10, 0.45]])  # a sensor's mixing and a warm light
QUANTISED = 1.0  # CIEDE2000 that bytes may cost, twice: as taken and corrected; dark colours most


def differences(pixels_bgr):
    """(10,) CIEDE2000 of the printed squares from what they are."""
    return ciede2000(lab_of(printed_colours(pixels_bgr)), lab_of(reference_linear(COLOUR_SQUARES)))


def test_board_under_white_light_is_left_as_it_is_and_a_known_camera_is_undone():
    as_it_is = measure_colour(*board_photo(COLOUR))
    assert (as_it_is.kind, as_it_is.flags) == ("colour", ())
    assert as_it_is.matrix == pytest.approx(np.eye(3), abs=0.01)
    assert as_it_is.delta_e_worst < QUANTISED
    photo, marker = board_photo(COLOUR, PHONE, noise=0.004)
    found = measure_colour(photo, marker)
    assert (found.kind, found.flags) == ("colour", ())
    assert found.matrix @ PHONE == pytest.approx(np.eye(3), abs=0.04)  # the ridge holds it back by so much
    assert differences(apply_colour(photo.pixels_bgr, found)).max() < 2.0
    assert found.delta_e_mean < 1.0
    dim = measure_colour(*board_photo(COLOUR, PHONE * 0.5)).matrix
    assert dim / 2 == pytest.approx(measure_colour(*board_photo(COLOUR, PHONE)).matrix, abs=0.03)  # the ridge
    across = places(COLOUR)[..., 0] / COLOUR.columns
    falls_off = measure_colour(*board_photo(COLOUR, PHONE, light=1.1 - 0.25 * across))
    assert falls_off.kind == "colour"
    assert falls_off.matrix @ PHONE == pytest.approx(np.eye(3), abs=0.06)


def test_paper_becomes_neutral_to_the_byte_and_paper_of_another_white_moves_exposure_by_nothing():
    photo, marker = board_photo(COLOUR, PHONE)
    assert np.ptp(apply_colour(photo.pixels_bgr, measure_colour(photo, marker))[30, 30].astype(int)) <= 1
    # On a print as office printers make it, white is the paper and the colours are brighter by it.
    photo, marker = board_photo(COLOUR, [0.7, 0.7, 0.7], paper=1.0)
    assert differences(apply_colour(photo.pixels_bgr, measure_colour(photo, marker))).max() < QUANTISED


@pytest.mark.parametrize("left_out", [0, 7])
def test_colour_that_the_fit_never_saw_comes_out_right(left_out):
    photo, marker = board_photo(COLOUR, PHONE)
    row, column = list(COLOUR_SQUARES)[left_out]
    at = np.floor(places(COLOUR)).astype(int)
    hidden = photo.pixels_bgr.copy()
    hidden[(at[..., 1] == row) & (at[..., 0] == column)] = 255  # glare
    found = measure_colour(Photo(hidden), marker)
    assert found.kind == "colour"
    assert "marker_colours_left_out" in found.flags
    assert differences(apply_colour(photo.pixels_bgr, found))[left_out] < 2.0


@pytest.mark.parametrize("gains", [(0.9, 0.9, 0.9), (0.3, 0.4, 0.6)])
def test_plain_board_gives_white_balance_and_exposure(gains):
    photo, marker = board_photo(PLAIN, gains)
    found = measure_colour(photo, marker)
    assert (found.kind, found.flags, found.delta_e_mean, found.delta_e_worst) == ("white", (), None, None)
    assert np.diag(found.matrix) * gains == pytest.approx(np.ones(3), rel=0.01)
    paper = apply_colour(photo.pixels_bgr, found)[20, 20].astype(int)
    assert paper == pytest.approx(np.full(3, 255 * float(encode_srgb(np.array(PAPER_WHITE)))), abs=1.0)


SHADOWS = {
    "through squares": lambda x, y: x < 1.5,
    "top": lambda x, y: y < 2.3,
    "corner": lambda x, y: (x < 1.6) & (y < 1.6),
    "slanting": lambda x, y: x / 4 + y / 5 < 1.0,
    "most": lambda x, y: x < 3.0,
}


def in_shadow(name, spec, factor):
    x, y = np.moveaxis(places(spec), -1, 0)
    return np.where(SHADOWS[name](x, y)[..., None], factor, 1.0)


@pytest.mark.parametrize("factor", [(0.3, 0.34, 0.4), (0.5, 0.5, 0.5)])
@pytest.mark.parametrize("name", list(SHADOWS))
def test_hard_shadow_is_told_and_what_is_lit_keeps_its_colours(name, factor):
    lit, marker = board_photo(COLOUR, PHONE)
    shaded, _ = board_photo(COLOUR, PHONE, light=in_shadow(name, COLOUR, factor))
    found = measure_colour(shaded, marker)
    assert found.kind == "colour"
    assert "marker_partly_shadowed" in found.flags
    assert differences(apply_colour(lit.pixels_bgr, found)).max() < 3.0


def test_shadow_over_the_whole_board_does_not_make_the_scene_too_bright():
    photo, marker = board_photo(PLAIN, [0.7, 0.7, 0.7], light=0.2)
    scene = np.full((4 * photo.pixels_bgr.shape[0], photo.pixels_bgr.shape[1], 3), 200, np.uint8)
    scene[: len(photo.pixels_bgr)] = photo.pixels_bgr
    found = measure_colour(Photo(scene), marker)
    assert "marker_darker_than_scene" in found.flags
    bright = LINEAR_OF_BYTE[200] * found.matrix[0, 0]
    assert bright == pytest.approx(1.25, rel=0.01)


def test_glare_all_over_the_sheet_and_a_print_of_other_colours_are_told():
    photo, marker = board_photo(PLAIN, [0.5, 0.5, 0.5])
    hazy = np.rint(255.0 * encode_srgb(linear_rgb(photo.pixels_bgr) * 0.6 + 0.25)).astype(np.uint8)[..., ::-1]
    assert "marker_washed_out" in measure_colour(Photo(np.ascontiguousarray(hazy)), marker).flags
    photo, marker = board_photo(COLOUR, [0.9, 0.8, 0.7])
    grey = cv2.cvtColor(cv2.cvtColor(photo.pixels_bgr, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    found = measure_colour(Photo(grey), marker)
    assert (found.kind, found.flags, found.delta_e_mean) == ("white", ("colour_white_only",), None)


def test_clipped_paper_is_told_and_the_colours_or_its_bound_set_exposure():
    photo, marker = board_photo(COLOUR, [1.3, 1.3, 1.3])
    found = measure_colour(photo, marker)
    assert (found.kind, found.flags) == ("colour", ("marker_overexposed",))
    assert found.matrix.sum(axis=1) == pytest.approx(np.full(3, 1 / 1.3), rel=0.02)
    unclipped = printed_colours(photo.pixels_bgr).max(axis=1) <= LINEAR_OF_BYTE[247]
    assert differences(apply_colour(photo.pixels_bgr, found))[unclipped].max() < QUANTISED
    plain = measure_colour(*board_photo(PLAIN, [1.3, 1.3, 0.9]))
    assert (plain.kind, plain.flags) == ("white", ("marker_overexposed",))
    assert np.diag(plain.matrix) == pytest.approx([0.84, 0.84, 1 / 0.9], rel=0.01)


GRID = np.stack(np.meshgrid(np.arange(3), np.arange(4)), -1).reshape(-1, 2) * 20.0
ODD_CORNERS = {
    "nan": np.full((12, 2), np.nan),
    "one place": np.zeros((12, 2)),
    "too few": np.zeros((5, 2)),
    "outside": GRID - 5000.0,
    "far": GRID * 1e8,
    "on a line": np.stack([np.arange(12.0) * 9, np.arange(12.0) * 9], -1),
}


@pytest.mark.parametrize("level", [0, 4, 60, 255])
def test_odd_corners_and_even_pictures_give_a_sane_answer(level):
    photo = Photo(np.full((240, 200, 3), level, np.uint8))
    for corners in ODD_CORNERS.values():
        found = measure_colour(photo, MarkerObservation(COLOUR, corners))
        assert found.kind in ("white", "none")
        assert np.isfinite(found.matrix).all()
    found = measure_colour(photo, board_photo(COLOUR)[1])
    assert found.kind == ("none" if level < 60 else "white")
    assert found.matrix == pytest.approx(np.eye(3) * found.matrix[0, 0])


def random_pixels(shape=(300, 70, 3)):
    return np.random.default_rng(1).integers(0, 256, shape, np.uint8)


def slow_apply(pixels_bgr, matrix):
    """One pixel's colour after the other by the definition, clipped ones as they are."""
    mixed = linear_rgb(pixels_bgr) @ matrix.T
    return np.rint(255.0 * encode_srgb(mixed))[..., ::-1]


@pytest.mark.parametrize("kind", ["colour", "white"])
def test_pixels_are_corrected_as_the_definition_says(kind):
    matrix = np.diag([1.1, 0.9, 1.3]) if kind == "white" else np.linalg.inv(PHONE) * 0.6
    pixels = random_pixels()
    found = apply_colour(pixels, ColourCorrection(matrix, kind))
    assert (found.shape, found.dtype) == (pixels.shape, np.uint8)
    known = pixels.max(axis=-1) <= 247
    assert np.abs(found.astype(float) - slow_apply(pixels, matrix))[known].max() <= 1.0  # rounding twice


@pytest.mark.parametrize("gains", [(0.8, 1.0, 1.3), (0.6, 0.7, 0.65), (1.5, 1.2, 1.1)])
@pytest.mark.parametrize("kind", ["colour", "white"])
def test_what_was_clipped_as_white_stays_neutral_and_brighter_pixels_never_become_darker(gains, kind):
    mixing = np.eye(3) if kind == "white" else np.array([[1.1, -0.1, 0.0], [-0.05, 1.1, -0.05], [0.0, -0.2, 1.2]])
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    found = apply_colour(ramp, ColourCorrection(mixing * gains, kind)).astype(int)
    assert np.ptp(found[0, 255]) <= 1
    assert found[0, 255].min() >= 255 * float(encode_srgb(np.array(min(1.0, max(gains))))) - 1
    if kind == "white":
        assert np.diff(found, axis=1).min() >= 0
