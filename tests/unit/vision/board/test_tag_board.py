"""Boards of tags: texts, layout against OpenCV's, corners and poses against known ones, covered boards, refusals."""

import numpy as np
import pytest

from app.core.errors import Failure, InvalidInputError
from app.vision.board.camera import estimate_views
from app.vision.board.colour_correction import measure_colour
from app.vision.board.marker import find_marker
from app.vision.board.pose import solve_pose
from app.vision.board.print_layout import (
    common_points,
    print_points_mm,
    seen_print_mm,
    seen_squares,
    tag_corners_mm,
)
from app.vision.marker_spec import MarkerSpec, parse_marker
from app.vision.model import EstimateOptions, MarkerObservation, Photo, PhotoPair
from app.vision.views.features import is_on_sheet
from tests.unit.vision.synthetic import PHONE, look_at, project, render_board
from tests.unit.vision.tag_boards import cv2_board, photograph, points_table, sheet_picture

ARUCO, CHARUCO = parse_marker("aruco:5x4:20:5:DICT_5X5_100"), parse_marker("charuco:7x5:18:13:DICT_4X4_50")
EVEN_ROWS = parse_marker("charuco:7x6:16:11:DICT_4X4_50")
BOTH = pytest.mark.parametrize("spec", [ARUCO, CHARUCO], ids=["aruco", "charuco"])
# Lines along borders leave 0.05 px under this noise; a corner of a ChArUco board, found alone, 0.1.
CORNER_RMS_PX = 0.15
SLANTED = look_at(elevation_deg=55.0, azimuth_deg=-70.0, distance_mm=320.0, roll_deg=20.0)


def observe(photo: Photo, spec: MarkerSpec) -> MarkerObservation:
    seen = find_marker(photo, spec)
    assert isinstance(seen, MarkerObservation), seen
    return seen


def refusal(photo: Photo, spec: MarkerSpec) -> Failure:
    failure = find_marker(photo, spec, "left")
    assert "left" in failure.message
    assert failure.advice
    return failure


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("aruco:5x7:35:5", "is no marker"),
        ("aruco:5x7:35:5:DICT_8X8_250", "no dictionary"),
        ("aruco:8x7:35:5:DICT_4X4_50", "need 56 tags, DICT_4X4_50 has 50"),
        ("charuco:6x4:20:20:DICT_4X4_50", "smaller than its squares"),
        ("aruco:5x7:35:0:DICT_6X6_250", "need a gap"),
        ("aruco:1x7:35:5:DICT_6X6_250", "tags a side"),
        ("aruco:5x7:35:5:DICT_6X6_250:thick=51", "thick"),
    ],
)
def test_impossible_board_of_tags_is_refused_with_its_reason(text, reason):
    with pytest.raises(InvalidInputError, match=reason) as refused:
        parse_marker(text)
    assert refused.value.code == "marker_invalid"


@pytest.mark.parametrize("spec", [ARUCO, CHARUCO, EVEN_ROWS], ids=str)
@pytest.mark.parametrize("is_legacy", [False, True])
def test_tags_and_points_lie_where_opencv_prints_them(spec, is_legacy):
    board = cv2_board(spec, is_legacy=is_legacy and spec.kind == "charuco")
    half = [spec.width_mm / 2, spec.height_mm / 2]
    upwards = (np.array(board.getObjPoints())[..., :2] - half) * [1.0, -1.0]
    assert tag_corners_mm(spec, is_legacy=is_legacy) == pytest.approx(upwards, abs=1e-4)
    if spec.kind == "charuco":
        upwards = (np.array(board.getChessboardCorners())[:, :2] - half) * [1.0, -1.0]
        assert print_points_mm(spec) == pytest.approx(upwards, abs=1e-4)


@BOTH
def test_whole_board_is_found_and_tells_the_pose(spec):
    pose = look_at(elevation_deg=55.0, azimuth_deg=-70.0, distance_mm=320.0, roll_deg=130.0)
    seen = observe(photograph(spec, pose), spec)
    truth = project(PHONE, pose, points_table(spec))
    assert seen.point_ids is not None
    assert len(seen.point_ids) == len(truth)
    assert np.sqrt(np.mean(np.sum((seen.corners_px - truth) ** 2, axis=1))) < CORNER_RMS_PX
    solved = solve_pose(PHONE, seen)
    # 0.1 px in 20 corners over 300 px: a third of a thousandth of the distance.
    assert -solved[0].T @ solved[1] == pytest.approx(pose.centre_mm, abs=1.0)


@BOTH
def test_covered_part_is_left_out_and_the_rest_tells_the_pose(spec):
    cover = (-100.0, -100.0, 105.0, 95.0)  # the lower left quarter and a little more
    seen = observe(photograph(spec, SLANTED, covers_mm=[cover]), spec)
    truth = project(PHONE, SLANTED, seen.seen_of(points_table(spec)))
    assert 0.4 * len(print_points_mm(spec)) < len(seen.corners_px) < 0.9 * len(print_points_mm(spec))
    assert np.abs(seen.corners_px - truth).max() < 0.5
    solved = solve_pose(PHONE, seen)
    assert -solved[0].T @ solved[1] == pytest.approx(SLANTED.centre_mm, abs=2.0)
    under_cover = np.array([[-40.0, -30.0, 0.0]])
    assert not is_on_sheet(seen, under_cover).any()
    assert is_on_sheet(seen, np.array([[40.0, 30.0, 0.0]])).all()


@BOTH
def test_too_small_a_part_is_refused(spec):
    for cover in [(-100.0, -100.0, 200.0, 127.0), (-30.0, -100.0, 200.0, 200.0)]:  # all but a row, all but a column
        assert refusal(photograph(spec, SLANTED, covers_mm=[cover]), spec).code == "marker_covered"


def test_frame_of_tags_leaves_the_food_in_its_middle_off_the_sheet():
    inside = (-36.0, -23.0, 72.0, 46.0)
    seen = observe(photograph(ARUCO, SLANTED, covers_mm=[inside]), ARUCO)
    assert seen_squares(seen).sum() == 14
    assert not is_on_sheet(seen, np.array([[0.0, 0.0, 30.0], [35.0, 20.0, 0.0]])).any()
    assert is_on_sheet(seen, np.array([[50.0, 0.0, 0.0], [0.0, 40.0, 0.0]])).all()
    assert len(seen_print_mm(seen)) == 4
    [sheet] = seen_print_mm(observe(photograph(CHARUCO, SLANTED), CHARUCO))  # a whole board: one with its margin
    assert sheet == pytest.approx((-63.0 - 8.0, -45.0 - 8.0, 63.0 + 8.0, 45.0 + 8.0))


OTHERS = {
    "dictionary": "aruco:5x4:20:5:DICT_6X6_250",
    "rows": "aruco:5x3:20:5:DICT_5X5_100",
    "kind": "charuco:5x4:20:14:DICT_5X5_100",
}


@pytest.mark.parametrize("announced", OTHERS.values(), ids=OTHERS)
def test_other_board_of_tags_is_a_mismatch(announced):
    assert refusal(photograph(ARUCO, SLANTED), parse_marker(announced)).code == "marker_mismatch"


PRINTS = {
    "mirrored aruco": (ARUCO, lambda: np.ascontiguousarray(sheet_picture(ARUCO)[:, ::-1]), "mirror"),
    "mirrored charuco": (CHARUCO, lambda: np.ascontiguousarray(sheet_picture(CHARUCO)[:, ::-1]), "mirror"),
    "charuco of the former pattern": (EVEN_ROWS, lambda: sheet_picture(EVEN_ROWS, is_legacy=True), "4.6"),
}


@pytest.mark.parametrize(("spec", "picture", "words"), PRINTS.values(), ids=PRINTS)
def test_board_printed_otherwise_is_told_as_such(spec, picture, words):
    failure = refusal(photograph(spec, SLANTED, picture=picture()), spec)
    assert failure.code == "marker_mismatch"
    assert words in failure.message
    checkerboard = refusal(render_board(parse_marker("plain:9x7:11"), PHONE, SLANTED), ARUCO)
    assert checkerboard.code == "marker_mismatch"
    assert "9x7" in checkerboard.message or "7x9" in checkerboard.message


@BOTH
def test_photograph_without_a_board_has_none_and_a_dark_one_is_told_as_dark(spec):
    rng = np.random.default_rng(0)
    pixels = np.clip(rng.normal(120.0, 30.0, (900, 1200, 3)), 0, 255).astype(np.uint8)
    assert refusal(Photo(pixels), spec).code == "marker_not_found"
    dark = photograph(spec, SLANTED, light=(0.003, 0.003, 0.003), noise=0.5)
    assert refusal(dark, spec).code == "image_too_dark"


@BOTH
def test_two_views_of_differently_covered_boards_tell_the_baseline(spec):
    poses = [look_at(elevation_deg=55.0, azimuth_deg=azimuth, distance_mm=320.0) for azimuth in (-100.0, -82.0)]
    covers = [[(20.0, -100.0, 100.0, 80.0)], [(-120.0, 20.0, 100.0, 80.0)]]
    photos = [photograph(spec, pose, covers_mm=cover) for pose, cover in zip(poses, covers, strict=True)]
    seen = observe(photos[0], spec), observe(photos[1], spec)
    assert len(common_points(*seen).first_px) < min(len(seen[0].corners_px), len(seen[1].corners_px))
    views = estimate_views(PhotoPair(photos[0], photos[1]), seen, EstimateOptions(spec, PHONE))
    assert not isinstance(views, Failure)
    baseline_mm = np.linalg.norm(views[0].centre_mm - views[1].centre_mm)
    assert baseline_mm == pytest.approx(np.linalg.norm(poses[0].centre_mm - poses[1].centre_mm), rel=0.01)


@BOTH
def test_white_is_balanced_by_the_boards_paper(spec):
    photo = photograph(spec, SLANTED, light=(0.6, 0.8, 0.9))
    correction = measure_colour(photo, observe(photo, spec))
    assert correction.kind == "white"
    assert correction.flags == ()
    gains = np.diag(correction.matrix)
    # Red first. Blur takes as much of white from each channel.
    assert gains / gains[1] == pytest.approx([0.8 / 0.9, 1.0, 0.8 / 0.6], rel=0.02)
    assert gains[1] == pytest.approx(1.0 / 0.8, rel=0.08)
