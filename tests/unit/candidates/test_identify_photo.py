"""`tada identify`: one photograph in, candidates out. The photograph is the demo's: a rendered apple and a marker."""

import importlib.resources
import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from app.candidates.identify_photo import identified_to_json, identify_photo, parse_box
from app.cli.main import cli
from app.core.errors import InvalidInputError
from app.identification.food_index import shipped_foods
from app.vision.looks.food_boxes import overlap, propose_boxes
from app.vision.marker_spec import ColourBoard, PlainBoard
from app.vision.model import Photo

APPLE_BOX = (978.0, 506.0, 231.0, 232.0)


@pytest.fixture(scope="module")
def photo():
    file = importlib.resources.files("app") / "demo_data" / "left.jpg"
    return Photo(cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_COLOR))


@pytest.fixture
def path(tmp_path, photo):
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), photo.pixels_bgr)
    return str(path)


def run(*arguments):
    return CliRunner().invoke(cli, ["identify", *arguments])


def test_apple_in_its_box_is_an_apple_before_all_others_and_all_probabilities_add_up_to_one(photo):
    found = identify_photo(photo, APPLE_BOX).place.identification
    first, second = found.candidates[:2]
    assert first.label == first.food_key == "apple"
    assert first.probability > 0.5 > second.probability
    assert found.none_probability < 0.5
    probabilities = [one.probability for one in found.candidates]
    assert len(probabilities) == len(shipped_foods())
    assert sum(probabilities) + found.none_probability == pytest.approx(1.0)
    assert probabilities == sorted(probabilities, reverse=True)
    grey = Photo(cv2.cvtColor(cv2.cvtColor(photo.pixels_bgr, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR))
    answer = identified_to_json(identify_photo(grey, APPLE_BOX))  # where the food is hardly known
    told = sum(one["probability"] for one in answer["candidates"])
    assert told + answer["none_of_these"] == pytest.approx(1.0, abs=0.5e-4 * len(shipped_foods()) + 1e-4)


def test_apple_is_found_where_nobody_points_at_it(photo):
    found = identify_photo(photo, None)
    assert found.place.identification.candidates[0].label == "apple"
    assert overlap(found.place.box, APPLE_BOX) > 0.6
    assert found.others == ()
    assert identify_photo(photo, None).place == found.place


def test_two_foods_apart_are_two_places(photo):
    mirrored = Photo(np.hstack([photo.pixels_bgr[300:900, 700:], photo.pixels_bgr[300:900, :699:-1]]))
    found = identify_photo(mirrored, None)
    assert [place.identification.candidates[0].label for place in (found.place, *found.others)] == ["apple", "apple"]
    answer = identified_to_json(found)
    assert {"groups", "candidates", "none_of_these", "box"} == set(answer["others"][0])


def test_colours_are_corrected_by_a_marker_that_is_told(photo):
    yellowish = Photo(np.clip(photo.pixels_bgr * np.array([0.6, 0.9, 1.0]), 0, 255).astype(np.uint8))
    spec = PlainBoard(9, 7, 11.0)
    as_taken, corrected = (identify_photo(yellowish, APPLE_BOX, marker) for marker in (None, spec))
    in_good_light = identify_photo(photo, APPLE_BOX, spec)
    chances = [each.place.identification.candidates[0].probability for each in (as_taken, corrected, in_good_light)]
    assert corrected.place.identification.candidates[0].label == "apple"
    assert abs(chances[1] - chances[2]) < abs(chances[0] - chances[2])


@pytest.mark.slow
def test_marker_that_is_not_there_is_told(photo):
    with pytest.raises(InvalidInputError) as raised:
        identify_photo(photo, APPLE_BOX, ColourBoard(4, 5, 12.0))
    assert raised.value.code in {"marker_not_found", "marker_mismatch"}


@pytest.mark.parametrize("box", ["5000,10,20,20", "10,10,0.2,0.2"])
def test_box_without_food_in_view_is_told(path, box):
    done = run(path, f"--box={box}")
    assert done.exit_code != 0
    assert done.exception.code == "box_outside"
    assert "1632 x 1224 px" in done.exception.message


@pytest.mark.parametrize("text", ["", "1,2,3", "1,2,3,4,5", "a,b,c,d", "1,2,0,4", "1,2,3,0", "nan,2,3,4"])
def test_what_is_no_box_is_told(text):
    with pytest.raises(InvalidInputError) as raised:
        parse_box(text)
    assert raised.value.code == "box_invalid"


def test_command_prints_the_agreed_keys_and_speaks_to_people_without_json(path):
    done = run(path, "--box", ",".join(map(str, APPLE_BOX)), "--json")
    answer = json.loads(done.stdout)
    assert done.exit_code == 0
    assert {"groups", "candidates", "none_of_these", "box", "others", "index_version", "seconds"} == set(answer)
    assert answer["candidates"][0]["food"] == "Apple, raw, with skin"
    assert {"food", "food_key", "label", "probability"} == set(answer["candidates"][0])
    done = run(path)
    assert "Apple, raw, with skin" in done.stdout
    assert "none that the index knows" in done.stdout


def test_file_that_is_no_photograph_is_told(tmp_path):
    path = tmp_path / "words.jpg"
    path.write_text("no photograph")
    assert run(str(path)).exception.code == "not_an_image"
    assert "cannot be read" in run(str(tmp_path / "missing.jpg")).exception.message


@pytest.mark.parametrize("pixels", [np.zeros((200, 300, 3), np.uint8), np.full((200, 300, 3), 255, np.uint8)])
def test_photograph_of_nothing_has_a_box_and_an_answer_and_a_disc_on_a_plain_ground_is_proposed(pixels):
    assert propose_boxes(pixels) == [(30.0, 20.0, 240.0, 160.0)]
    assert identify_photo(Photo(pixels), None).place.identification.candidates
    pixels = np.full((600, 800, 3), 200, np.uint8)
    cv2.circle(pixels, (300, 250), 90, (40, 60, 180), -1)
    assert max(overlap(box, (210.0, 160.0, 180.0, 180.0)) for box in propose_boxes(pixels)) > 0.85
