"""A colour correction on its way: as JSON and back, and what `tada marker --find` tells of it."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from app.cli.main import cli
from app.meals.estimate.estimate_json import answer_of, colour_from_json, colour_to_json
from app.vision.marker_spec import parse_marker
from app.vision.model import ColourCorrection, EstimateOptions, MealEstimate
from tests.unit.vision.boards import COLOUR, PLAIN, board_photo

CORRECTION = ColourCorrection(
    np.array([[1.2, -0.1, 0.0], [0.01234, 1.0, 0.1], [0.0, 0.0, 1.5]]), "colour", 0.66, 2.31, ("marker_overexposed",)
)
PLAIN_ONE = ColourCorrection(np.diag([1.1, 1.0, 1.2]), "white")


@pytest.mark.parametrize("correction", [CORRECTION, PLAIN_ONE, ColourCorrection(np.eye(3), "none")])
def test_correction_comes_back_from_json(correction):
    found = colour_from_json(json.loads(json.dumps(colour_to_json(correction))))
    assert np.array_equal(found.matrix, correction.matrix)
    told = ("kind", "delta_e_mean", "delta_e_worst", "flags")
    assert [getattr(found, name) for name in told] == [getattr(correction, name) for name in told]


def test_answer_tells_both_sides_or_null():
    options = EstimateOptions(parse_marker("plain:9x7:11"))
    estimate = MealEstimate("shape", "5", {}, colours=(CORRECTION, PLAIN_ONE))
    colour = answer_of(estimate, options).as_json()["colour"]
    assert (colour["left"]["kind"], colour["right"]["kind"]) == ("colour", "white")
    assert colour["left"]["delta_e_worst"] == 2.31
    assert answer_of(MealEstimate("shape", "5", {}), options).as_json()["colour"] is None


def found_marker(tmp_path, spec, *arguments):
    path = tmp_path / "board.png"
    cv2.imwrite(str(path), board_photo(spec, [0.8, 0.7, 0.6], square_px=80)[0].pixels_bgr)
    return CliRunner().invoke(cli, ["marker", "--marker", str(spec), "--find", str(path), *arguments])


def test_marker_command_tells_how_right_a_printed_board_is(tmp_path):
    answer = json.loads(found_marker(tmp_path, COLOUR, "--json").stdout)
    assert (answer["found"], answer["colour"]["kind"], answer["colour"]["flags"]) == (True, "colour", [])
    assert answer["colour"]["delta_e_worst"] < 1.0
    assert "its worst square" in found_marker(tmp_path, COLOUR).stdout
    plain = json.loads(found_marker(tmp_path, PLAIN, "--json").stdout)
    assert (plain["colour"]["kind"], plain["colour"]["delta_e_worst"]) == ("white", None)
    assert "its worst square" not in found_marker(tmp_path, PLAIN).stdout
