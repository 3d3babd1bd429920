"""Finding the board: corners against the projection of true ones, order, agreement of two views, and every refusal."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.core.errors import Failure, InvalidInputError
from app.vision.board.marker import agree_on_corners, find_marker, readings
from app.vision.intrinsics import Camera
from app.vision.marker_spec import USUAL, MarkerSpec, parse_marker
from app.vision.model import MarkerObservation, Photo, PhotoPair
from app.vision.photograph.photo import read_photo
from tests.unit.vision.synthetic import (
    PHONE,
    corner_points,
    look_at,
    noise_texture,
    paint_over,
    project,
    render_board,
)

PLAIN, ODD, COLOUR = parse_marker("plain:9x7:11"), parse_marker("plain:10x7:11"), parse_marker("colour:4x5:12")
# Sub-pixel detectors leave 0.05 to 0.1 px under this noise and blur; the colour board's squares differ in contrast.
CORNER_RMS_PX = {"plain": 0.15, "colour": 0.2}

LENS = replace(PHONE, distortion=(-0.25, 0.1, 0.001, -0.001, 0.0))
LARGE = Camera(4032, 3024, 3100.0, 3100.0, 2015.5, 1511.5)


def observe(photo: Photo, spec: MarkerSpec) -> MarkerObservation:
    seen = find_marker(photo, spec)
    assert isinstance(seen, MarkerObservation), seen
    return seen


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))


def refusal(photo: Photo, spec: MarkerSpec) -> Failure:
    failure = find_marker(photo, spec, "left")
    assert "left" in failure.message
    assert failure.advice
    return failure


TAGS = ["aruco:4x3:14.4236:3.61:DICT_4X4_50", "charuco:6x4:20:14:DICT_APRILTAG_36H11:thick=3.2"]


@pytest.mark.parametrize("text", [*USUAL, "plain:20x14:6.5", "plain:9x7:11:thick=8.7", *TAGS])
def test_marker_text_is_read_and_written_back(text):
    assert str(parse_marker(text)) == text
    assert parse_marker(text.replace("36H11", "36h11")) == parse_marker(text)  # as OpenCV writes it


BAD_TEXTS = (
    "|plain|plain:9x7:0|plain:9x7:-1|plain:3x7:11|plain:9x41:11|plain:9x7:201|dots:9x7:11|colour:9x7:11"
    "|plain:9x7:11:thick=51|plain:9x7:11:thick=|plain:9x7:11:8.7|plain:9x7:1e2|plain:9x7:11\n|plain:9×7:11|plain:٩x7:11"
)


@pytest.mark.parametrize("text", BAD_TEXTS.split("|"))
def test_bad_marker_text_is_refused_with_a_sentence(text):
    with pytest.raises(InvalidInputError) as refused:
        parse_marker(text)
    assert refused.value.code == "marker_invalid"
    assert refused.value.message.endswith(".")


@pytest.mark.parametrize("spec", [ODD, COLOUR], ids=str)
@pytest.mark.parametrize(("elevation_deg", "azimuth_deg", "roll_deg"), [(50, -90, 0), (40, 150, -135), (30, -60, 20)])
def test_corners_are_where_they_are_and_in_the_prints_order(spec, elevation_deg, azimuth_deg, roll_deg):
    pose = look_at(elevation_deg, azimuth_deg, roll_deg=roll_deg)
    photo = render_board(spec, PHONE, pose, table=noise_texture(1))
    seen = observe(photo, spec)
    assert rms(seen.corners_px, project(PHONE, pose, corner_points(spec))) < CORNER_RMS_PX[spec.kind]


@pytest.mark.parametrize(
    ("marker", "camera", "pose", "render", "rms_px"),
    [
        ("plain:10x7:11", LENS, look_at(55, -70, 250.0, target_mm=(60, 30, 0)), {}, 0.15),
        # A shadow's edge as sharp as a print's moves the corners that it runs through, by less than half a pixel.
        ("plain:10x7:11", PHONE, look_at(50, -80), {"shadow": 0.3}, 0.4),
        ("plain:7x6:11", PHONE, look_at(70, -90, 110.0), {}, 0.15),
        pytest.param(  # found on the reduced image and refined on the whole
            *("plain:10x7:11", LARGE, look_at(45, -60, 450.0, target_mm=(80, 40, 0)), {"blur_px": 1.0}, 0.15),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["lens distortion", "hard shadow", "board that fills the photograph", "twelve megapixels"],
)
def test_corners_are_where_they_are_under_difficulties(marker, camera, pose, render, rms_px):
    spec = parse_marker(marker)
    table = None if camera is LARGE else noise_texture(2)
    seen = observe(render_board(spec, camera, pose, table=table, **render), spec)
    assert rms(seen.corners_px, project(camera, pose, corner_points(spec))) < rms_px


@pytest.mark.parametrize(
    ("marker", "ways"), [("plain:9x7:11", 2), ("plain:10x7:11", 1), ("plain:8x8:11", 2), ("plain:7x7:11", 4)]
)
def test_readings_are_those_that_the_looks_allow(marker, ways):
    spec = parse_marker(marker)
    observation = MarkerObservation(spec, corner_points(spec)[:, :2])
    assert len(readings(observation)) == ways
    assert readings(observation)[0].corners_px == pytest.approx(observation.corners_px)


ABOVE = look_at(88, -97)


@pytest.mark.parametrize(
    ("marker", "poses", "textures"),
    [
        ("plain:9x7:11", (look_at(50, -97), look_at(47, -83, roll_deg=180)), (5, 5)),
        ("plain:7x7:12", (look_at(50, -97), look_at(47, -83, roll_deg=-90)), (5, 5)),
        ("plain:9x7:11", (ABOVE, look_at(86, 60, roll_deg=90)), (6, 6)),
        ("plain:9x7:11", (ABOVE, look_at(87, -85, roll_deg=10)), (None, None)),
    ],
    ids=["half", "square board", "above, quarter", "above a bare table, by the smaller roll"],
)
def test_views_agree_whichever_way_the_phone_is_rolled(marker, poses, textures):
    spec = parse_marker(marker)
    tables = [None if seed is None else noise_texture(seed) for seed in textures]
    photos = [render_board(spec, PHONE, pose, table=table) for pose, table in zip(poses, tables, strict=True)]
    seen = [observe(photo, spec) for photo in photos]
    for way in readings(seen[1]):  # whatever the detector chose
        left, right = agree_on_corners(PhotoPair(*photos), seen[0], way)
        truth = [MarkerObservation(spec, project(PHONE, pose, corner_points(spec))) for pose in poses]
        turns = [
            int(np.argmin([rms(reading.corners_px, observed.corners_px) for reading in readings(true)]))
            for true, observed in zip(truth, (left, right), strict=True)
        ]
        assert turns[0] == turns[1]


def test_picture_without_the_announced_board_is_refused():
    blank = Photo(np.full((900, 1200, 3), 128, np.uint8))
    assert refusal(blank, PLAIN).code in {"marker_not_found", "image_blurred"}
    table = cv2.resize((255 * noise_texture(4, 300)).astype(np.uint8), (1200, 900), interpolation=cv2.INTER_NEAREST)
    assert refusal(Photo(table), PLAIN).code == refusal(Photo(table), COLOUR).code == "marker_not_found"
    squares = (np.add.outer(np.arange(900) // 40, np.arange(1200) // 40) % 2 * 180 + 30).astype(np.uint8)
    cloth = Photo(np.repeat(squares[..., None], 3, axis=2))
    assert refusal(cloth, PLAIN).code in {"marker_mismatch", "marker_covered", "marker_not_found"}


def test_board_that_cannot_be_read_is_refused_with_the_reason():
    pose = look_at(60, -90)
    lying = project(PHONE, pose, np.array([[15.0, -80, 0], [90, -80, 0], [90, 80, 0], [15, 80, 0]]))
    assert refusal(paint_over(render_board(PLAIN, PHONE, pose), lying), PLAIN).code == "marker_covered"
    half_outside = render_board(PLAIN, PHONE, look_at(60, -90, 250.0, target_mm=(140, 0, 0)))
    assert refusal(half_outside, PLAIN).code in {"marker_covered", "marker_not_found"}
    dark = render_board(PLAIN, PHONE, look_at(), exposure=0.005, noise=1.0)
    assert refusal(dark, PLAIN).code == "image_too_dark"
    for blur_px in (5.0, 25.0):
        blurred = render_board(PLAIN, PHONE, look_at(), blur_px=blur_px, table=noise_texture(8))
        assert refusal(blurred, PLAIN).code == "image_blurred"


def test_squares_too_small_for_their_edges_to_be_followed_are_not_called_blurred():
    small = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
    photo = render_board(PLAIN, small, look_at(50, -60, 500.0), blur_px=0.5, table=noise_texture(8))
    assert rms(observe(photo, PLAIN).corners_px, project(small, look_at(50, -60, 500.0), corner_points(PLAIN))) < 0.3


@pytest.mark.parametrize(
    ("printed", "announced", "words"),
    [
        ("plain:7x5:14", "plain:9x7:11", ["7x5 squares", "plain:9x7:11"]),
        ("plain:10x7:11", "plain:9x7:11", ["10x7 squares", "plain:9x7:11"]),
        ("plain:9x7:11", "colour:4x5:12", []),
        ("plain:4x5:12", "colour:4x5:12", []),
        ("colour:4x5:12", "plain:4x5:12", []),
        ("plain:7x10:11", "plain:6x9:11", ["7x10 squares", "count squares, not inner corners"]),
    ],
)
def test_another_board_than_announced_is_a_mismatch_told_with_its_size(printed, announced, words):
    photo = render_board(parse_marker(printed), PHONE, look_at(55, -70), table=noise_texture(7))
    failure = refusal(photo, parse_marker(announced))
    assert failure.code == "marker_mismatch"
    assert all(word in failure.message for word in words)
    if words:
        assert ("inner corners" in failure.message) == (printed in failure.advice) == ("6x9" in announced)


@pytest.mark.slow
def test_every_photograph_of_a_real_board_is_found(shared_data):
    spec = parse_marker("plain:10x7:25")
    files = sorted((shared_data / "photos" / "chessboards").glob("*.jpg"))
    assert len(files) == 26
    missing = [file.name for file in files if not find_marker(read_photo(file.read_bytes(), max_pixels=10**7), spec)]
    assert missing == []
