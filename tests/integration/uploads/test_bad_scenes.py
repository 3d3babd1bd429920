"""The whole estimate on the bundled pair, made bad in the ways that phones and people make it: each has its answer."""

import io
import pathlib

import cv2
import numpy as np
import pytest
from PIL import Image

from app.estimates.estimate_json import options_from_json
from app.estimates.run_estimate import run_estimate
from app.vision.board.marker import find_marker
from app.vision.marker_spec import parse_marker
from app.vision.model import Photo

PAIR = pathlib.Path(__file__).parents[3] / "app" / "demo_data"
MARKER = "plain:9x7:11"
APPLE = (1092, 620)
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pixels():
    return {slot: cv2.imread(str(PAIR / f"{slot}.jpg")) for slot in ("left", "right")}


@pytest.fixture(scope="module")
def volume_ml(tmp_path_factory):
    """The apple's volume as measured from the pair as it is."""
    answer = estimate(tmp_path_factory.mktemp("plain"), original("left"), original("right"), point=APPLE)
    return answer["items"][0]["volume_ml"]


def original(slot):
    return (PAIR / f"{slot}.jpg").read_bytes()


def encoded(image, kind="JPEG", orientation=None):
    with Image.open(PAIR / "left.jpg") as photograph:
        exif = photograph.getexif()
    if orientation is not None:
        exif[0x0112] = orientation
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image[..., ::-1])).save(buffer, kind, quality=90, exif=exif)
    return buffer.getvalue()


def estimate(folder, left, right, *, marker=MARKER, point=None, **options):
    paths = {"left": folder / "left", "right": folder / "right"}
    for path, content in zip(paths.values(), (left, right), strict=True):
        path.write_bytes(content)
    hints = [{"point": list(point), "food": "apple"}] if point else []
    value = {"marker": marker, "camera": None, "hints": hints} | options
    answer, _ = run_estimate(
        paths, options_from_json(value), max_pixels=60_000_000, on_stage=lambda _: None, want_artefacts=False
    )
    return answer.as_json()


def without_board(image):
    """The photograph with its board, margin and all, painted over."""
    corners = find_marker(Photo(image), parse_marker(MARKER)).corners_px
    middle = corners.mean(axis=0)
    outline = cv2.convexHull(((corners - middle) * 1.7 + middle).astype(np.float32)).reshape(-1, 2)
    return cv2.fillPoly(image.copy(), [outline.astype(np.int32)], (90, 120, 150))


def test_left_and_right_swapped_simply_work(tmp_path, volume_ml):
    answer = estimate(tmp_path, original("right"), original("left"))
    assert answer["failure"] is None
    assert answer["items"][0]["volume_ml"] == pytest.approx(volume_ml, rel=0.1)  # the other view leads: other pixels


def test_photographs_of_different_sizes_and_formats_work(tmp_path, pixels, volume_ml):
    smaller = cv2.resize(pixels["right"], None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)
    answer = estimate(tmp_path, original("left"), encoded(smaller, "PNG"), point=APPLE)
    assert answer["items"][0]["volume_ml"] == pytest.approx(volume_ml, rel=0.1)


def test_phone_on_its_side_gives_the_same_volume(tmp_path, pixels, volume_ml):
    turned = [encoded(np.rot90(pixels[slot]), orientation=6) for slot in ("left", "right")]  # 6: turn it back clockwise
    answer = estimate(tmp_path, *turned, point=APPLE)
    assert answer["items"][0]["volume_ml"] == pytest.approx(volume_ml, rel=0.05)
    assert (answer["camera"]["width"], answer["camera"]["height"]) == (1632, 1224)


def test_marker_in_the_left_view_only_is_measured_by_that_view(tmp_path, pixels, volume_ml):
    answer = estimate(tmp_path, original("left"), encoded(without_board(pixels["right"])), point=APPLE)
    assert answer["failure"] is None
    [item] = [each for each in answer["items"] if each["hint"] == 0]
    assert "single_view" in item["flags"]
    assert item["volume_interval_ml"][0] < volume_ml < item["volume_interval_ml"][1]


NO_MARKER = {"marker_mismatch", "marker_not_found", "marker_covered"}
SCENES = {
    "the same twice": (lambda pixels: {"right": original("left")}, {"same_photograph"}),
    "no marker in the left photograph": (
        lambda pixels: {"left": encoded(without_board(pixels["left"]))},
        {"marker_not_found"},
    ),
    "another plain board": (lambda _: {"marker": "plain:7x5:11"}, NO_MARKER),
    "blurred": (lambda pixels: {"left": encoded(cv2.GaussianBlur(pixels["left"], (0, 0), 12))}, {"image_blurred"}),
    "too small a step": (
        lambda pixels: {"right": encoded(turned_by_a_degree(pixels["left"]))},
        {"baseline_too_small", "same_photograph"},
    ),
    "camera of another size": (
        lambda _: {"camera": {"width": 1000, "height": 999, "fx": 1500, "fy": 1500, "cx": 500, "cy": 500}},
        {"camera_mismatch"},
    ),
}


def turned_by_a_degree(image):
    return cv2.warpAffine(image, cv2.getRotationMatrix2D((816, 612), 1.0, 1.0), (1632, 1224))


@pytest.mark.parametrize("name", SCENES)
def test_scene_that_cannot_be_measured_fails_with_its_code(tmp_path, pixels, name):
    change, codes = SCENES[name]
    failed = estimate(tmp_path, **({"left": original("left"), "right": original("right")} | change(pixels)))
    assert failed["items"] == []
    assert failed["failure"]["code"] in codes
    assert len(failed["failure"]["message"]) > 20
    assert "in the left" not in name or "left" in failed["failure"]["message"]


def test_marker_corners_do_not_depend_on_what_the_process_did_before(pixels):
    corners = []
    for seed in (0, 6):  # unseeded, the detector meets different grids after these two
        cv2.setRNGSeed(seed)
        corners.append(find_marker(Photo(pixels["right"]), parse_marker(MARKER)).corners_px)
    assert all(np.array_equal(corners[0], other) for other in corners[1:])
