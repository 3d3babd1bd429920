"""The capture page's live help (app/capture/static/live) on rendered frames: board, angle, quality, advice, worker."""

import base64
import pathlib
from functools import cache

import cv2
import numpy as np
import pytest

import app
from app.vision.marker_spec import USUAL, TagBoard, parse_marker
from benchmarks.board_detector import reduced, tilted
from tests.e2e.capture.board_frames import SIZE, frame_of, look_at
from tests.e2e.static_modules import module_page

LIVE = pathlib.Path(app.__path__[0]) / "capture" / "static" / "live"
PLAIN = "plain:9x7:11"
MARKERS = [
    PLAIN,
    "plain:8x7:12:thick=8.7",
    "colour:4x5:12",
    "charuco:6x4:20:14:DICT_4X4_50",
    "aruco:5x7:20:4:DICT_6X6_250",
    "aruco:4x3:20:5:DICT_APRILTAG_36H11",
]
STEEP = look_at(10, 35, 420)


@pytest.fixture(scope="module")
def run(chromium):
    """Run a script with the modules as live.NAME and `frames`: [{gray, width, height}]; return its value."""
    names = ["board_detector", "view_angle", "frame_quality", "advice", "markers"]
    imports = ", ".join(f'{name}: await import("/{name}.js")' for name in names)
    decode = """
      const frames = encoded.map(({ width, height, gray }) => (
        { width, height, gray: Uint8Array.from(atob(gray), (letter) => letter.charCodeAt(0)) }));
    """

    def evaluate(script, frames=(), argument=None):
        encoded = [
            {"width": each.shape[1], "height": each.shape[0], "gray": base64.b64encode(each.tobytes()).decode()}
            for each in frames
        ]
        body = f"async ([encoded, argument]) => {{ {decode} const live = {{ {imports} }}; {script} }}"
        return page.evaluate(body, [encoded, argument])

    with module_page(chromium, LIVE) as page:
        yield evaluate


def boards(run, frames, marker):
    script = (
        "return frames.map(({ gray, width, height }) => live.board_detector.findBoard(gray, width, height, argument));"
    )
    return run(script, frames, marker)


def corner_errors(board, corners):
    """(4,) px to the true corners, in the reading that fits best: some boards look alike turned."""
    turned = [np.roll(np.array(board["corners"]), turn, axis=0) for turn in range(4)]
    return min((np.linalg.norm(each - corners, axis=1) for each in turned), key=np.max)


@pytest.mark.parametrize("marker", MARKERS)
def test_corners_of_a_rendered_board_are_found_to_half_a_pixel(run, marker):
    poses = [look_at(0, 0, 420), STEEP, look_at(-20, 50, 450), look_at(15, 30, 420, roll_deg=90)]
    rendered = [frame_of(marker, pose) for pose in poses]
    for board, (_, corners) in zip(boards(run, [frame for frame, _ in rendered], marker), rendered, strict=True):
        assert board is not None
        assert (board["is_whole"], board["is_enough"], board["share"]) == (True, True, 1)
        assert corner_errors(board, corners).max() < 0.5


def test_board_of_odd_sum_starts_at_the_prints_own_corner_however_it_lies(run):
    rendered = [frame_of("colour:4x5:12", look_at(azimuth, 35, 420)) for azimuth in (0, 90, 180, 270)]
    for board, (_, corners) in zip(
        boards(run, [frame for frame, _ in rendered], "colour:4x5:12"), rendered, strict=True
    ):
        assert np.array(board["corners"]) == pytest.approx(corners, abs=0.5)


@pytest.mark.parametrize("marker", MARKERS)
def test_board_that_leaves_the_frame_is_no_whole_board(run, marker):
    frame, corners = frame_of(marker, STEEP)
    cut = int(corners[:, 0].min() + 0.7 * np.ptp(corners[:, 0]))
    [board] = boards(run, [np.ascontiguousarray(frame[:, :cut])], marker)
    assert board is not None
    assert not board["is_whole"]
    assert 0.3 < board["share"] < 0.9


def test_board_of_tags_that_is_partly_covered_is_enough_and_a_checkerboard_is_not(run):
    for marker, is_enough in (("aruco:5x7:20:4:DICT_6X6_250", True), (PLAIN, False)):
        frame, corners = frame_of(marker, STEEP)
        cv2.circle(frame, np.rint(corners[2]).astype(int).tolist(), int(np.ptp(corners[:, 0]) / 4), 140, -1)
        [board] = boards(run, [frame], marker)
        assert (board["is_whole"], board["is_enough"]) == (False, is_enough)


def test_another_board_than_announced_is_none(run):
    frame, _ = frame_of(PLAIN, STEEP)
    for other in ("plain:7x5:15", "plain:10x8:11", "colour:4x5:12", "aruco:5x7:20:4:DICT_6X6_250"):
        assert boards(run, [frame], other) == [None]
    tags, _ = frame_of("aruco:5x7:20:4:DICT_6X6_250", STEEP)
    assert boards(run, [tags], "aruco:5x7:20:12:DICT_6X6_250") == [None]  # another gap


@cache
def textures():
    """Noise, stripes, dots, a chequered cloth, tiles, and lines of print-like dashes, all (480, 640)."""
    width, height = SIZE
    y, x = np.mgrid[:height, :width]
    noise = np.random.default_rng(3).normal(128, 50, (height, width))
    dots = np.full((height, width), 220.0)
    for top in range(20, height, 24):
        for left in range(20, width, 24):
            cv2.circle(dots, (left, top), 7, 40, -1)
    frames = {
        "noise": noise,
        "soft noise": 128 + 9 * cv2.GaussianBlur(noise - 128, (0, 0), 4),
        "stripes": 128 + 100 * np.sign(np.sin(x / 5 + y / 9)),
        "dots": dots,
        "cloth": np.where((x // 14 + y // 14) % 2 == 0, 40, 215),
        "tiles": np.where((x % 40 < 34) & (y % 40 < 34), 60, 220),
        "grating": 128 + 50 * np.sin(x / 4) + 50 * np.sin(y / 4),
        "flat": np.full((height, width), 200),
    }
    return {name: np.clip(frame, 0, 255).astype(np.uint8) for name, frame in frames.items()}


@pytest.mark.parametrize("marker", MARKERS[1:5])  # of each kind one
def test_textures_are_no_board(run, marker):
    frames = textures()
    seen = dict(zip(frames, boards(run, frames.values(), marker), strict=True))
    assert seen == dict.fromkeys(frames)


def test_lattice_that_takes_in_and_drops_the_same_place_of_a_print_ends(run, shared_data):
    """A newspaper seen at a slant: growing went on for ever."""
    photo = cv2.imread(str(shared_data / "scenes" / "dev" / "vessels" / "vessel-03-glass" / "right.jpg"))
    [board] = boards(run, [cv2.cvtColor(tilted(reduced(photo)), cv2.COLOR_BGR2GRAY)], PLAIN)
    assert board is not None


@pytest.mark.parametrize("marker", [PLAIN, "colour:4x5:12", "aruco:5x7:20:4:DICT_6X6_250"])
def test_angle_and_side_of_the_second_view_are_those_of_the_cameras(run, marker):
    first = frame_of(marker, look_at(-4, 40, 420))
    views = [(8, 40), (15, 40), (-30, 40), (-4, 52), (10, 20)]
    seconds = [frame_of(marker, look_at(azimuth, tilt, 430, roll_deg=6)) for azimuth, tilt in views]
    script = """
      const [first, ...seconds] = frames.map(({ gray, width, height }) => (
        { ...live.board_detector.findBoard(gray, width, height, argument), width, height }));
      const { cameraPose, viewAngle } = live.view_angle;
      const measured = (view) => [viewAngle(first, view, argument), cameraPose(view.corners, view, argument)];
      return seconds.map(measured);
    """
    measured = run(script, [first[0], *(frame for frame, _ in seconds)], marker)
    start = camera_centre(look_at(-4, 40, 420))
    for (azimuth, tilt), (angle, pose) in zip(views, measured, strict=True):
        there = camera_centre(look_at(azimuth, tilt, 430))
        true_deg = np.degrees(np.arccos(start @ there / np.linalg.norm(start) / np.linalg.norm(there)))
        assert angle["angle_deg"] == pytest.approx(true_deg, abs=1)
        assert pose["tilt_deg"] == pytest.approx(tilt, abs=1)
        assert pose["distance_mm"] == pytest.approx(430, rel=0.02)
        if azimuth != -4:
            assert angle["side"] == ("right" if azimuth > -4 else "left")
        else:
            assert angle["up_deg"] == pytest.approx(-true_deg, abs=1)  # flatter: the camera has come down


def camera_centre(pose):
    return -pose[0].T @ pose[1]


def test_same_view_twice_has_no_angle_and_lengths_twice_as_large_are_seen_from_twice_as_far(run):
    corners = frame_of(PLAIN, STEEP)[1].tolist()
    script = """
      const view = { corners: argument, width: 640, height: 480 };
      const { viewAngle, cameraPose } = live.view_angle;
      const poses = ["plain:9x7:11", "plain:9x7:22"].map((marker) => cameraPose(argument, view, marker));
      return [viewAngle(view, view, "plain:9x7:11").angle_deg, ...poses];
    """
    angle_deg, near, far = run(script, argument=corners)
    assert angle_deg == pytest.approx(0, abs=1e-6)
    assert near["distance_mm"] == pytest.approx(420, rel=1e-3)
    assert far["distance_mm"] == pytest.approx(2 * near["distance_mm"])
    assert far["tilt_deg"] == pytest.approx(near["tilt_deg"]) == pytest.approx(35, abs=0.1)


def test_quality_tells_blur_in_px_and_light_with_and_without_the_board(run):
    frames = [frame_of(PLAIN, STEEP, blur_px=blur)[0] for blur in (0.4, 2.0)]
    frames += [(frames[0] * 0.2).astype(np.uint8), np.where(frames[0] > 150, 255, frames[0]).astype(np.uint8)]
    script = """
      return frames.map(({ gray, width, height }) => {
        const board = live.board_detector.findBoard(gray, width, height, argument);
        return [board, null].map((seen) => live.frame_quality.frameQuality(gray, width, height, seen, argument));
      });
    """
    (sharp, sharp_frame), (blurred, blurred_frame), (dark, dark_frame), (clipped, _) = run(script, frames, PLAIN)
    assert sharp["edge_width_px"] < 2
    assert blurred["edge_width_px"] == pytest.approx(
        2.56 * np.hypot(2.0, 0.5), rel=0.15
    )  # 0.5: a pixel and the print's own
    assert blurred_frame["edge_width_px"] > 1.5 * sharp_frame["edge_width_px"]
    assert sharp["light_level"] == pytest.approx(235, abs=8)
    assert dark["light_level"] == pytest.approx(47, abs=3)
    assert dark_frame["light_level"] < 60
    assert (sharp["clipped_share"], clipped["clipped_share"]) == (
        pytest.approx(0, abs=0.01),
        pytest.approx(0.5, abs=0.15),
    )
    assert sharp["has_room"]


GOOD_CORNERS = [[240, 180], [400, 180], [420, 300], [230, 300]]
GOOD = {
    "width": 640,
    "height": 480,
    "marker": PLAIN,
    "board": {"corners": GOOD_CORNERS, "share": 1, "is_whole": True, "is_enough": True},
    "quality": {"light_level": 200, "clipped_share": 0, "edge_width_px": 2, "has_room": True},
    "pose": {"tilt_deg": 40, "distance_mm": 400},
    "angle": {"angle_deg": 11, "right_deg": 11, "up_deg": 0, "side": "right"},
}


def altered(part, **values):
    return {**GOOD, part: {**GOOD[part], **values}}


CASES = [
    ("good", GOOD),
    ("good", {**GOOD, "angle": None}),
    ("no_board", {**GOOD, "board": None}),
    ("too_dark", {**GOOD, "board": None, "quality": {**GOOD["quality"], "light_level": 20}}),
    ("blurred", {**GOOD, "board": None, "quality": {**GOOD["quality"], "edge_width_px": 12}}),
    ("board_cut_off", altered("board", is_enough=False)),
    ("board_cut_off", altered("quality", has_room=False)),
    ("too_dark", altered("quality", light_level=30)),
    ("too_bright", altered("quality", clipped_share=0.9)),
    ("blurred", altered("quality", edge_width_px=6)),
    ("too_far", altered("board", corners=[[240, 180], [280, 180], [284, 210], [236, 210]])),
    ("too_far", altered("pose", distance_mm=1200)),
    ("too_close", altered("board", corners=[[20, 20], [620, 20], [620, 460], [20, 460]])),
    ("too_steep", altered("pose", tilt_deg=4)),
    ("too_flat", altered("pose", tilt_deg=75)),
    ("move_right", altered("angle", angle_deg=3, right_deg=3)),
    ("move_right", altered("angle", angle_deg=11, right_deg=-11, side="left")),
    ("move_right", altered("angle", angle_deg=11, right_deg=1, up_deg=11)),
    ("move_left", altered("angle", angle_deg=20, right_deg=20)),
    ("too_far_apart", altered("angle", angle_deg=40, right_deg=30)),
]


def test_every_code_is_given_where_it_is_due(run):
    codes = run("return argument.map((each) => live.advice.frameCode(each));", argument=[case for _, case in CASES])
    assert codes == [code for code, _ in CASES]
    assert set(codes) == set(run("return live.advice.CODES;"))


def test_advice_changes_once_three_frames_in_a_row_ask_for_another(run):
    other = altered("angle", angle_deg=3, right_deg=3)
    frames = [GOOD, other, other, GOOD, other, other, other, GOOD]
    script = """
      let state = null;
      return argument.map((each) => { state = live.advice.advise(state, each); return state.code; });
    """
    assert run(script, argument=frames) == [*["good"] * 6, "move_right", "move_right"]


def test_advice_at_a_limit_stays_what_it_was(run):
    """At 8 degrees and a little less `good` stays good, and `move_right` stays until a little more."""
    angles = [altered("angle", angle_deg=angle, right_deg=angle) for angle in (7.6, 8.4)]
    script = (
        'return ["good", "move_right"].map((before) => argument.map((each) => live.advice.frameCode(each, before)));'
    )
    assert run(script, argument=angles) == [["good", "good"], ["move_right", "move_right"]]


def test_marker_texts_are_read_as_the_server_reads_them(run):
    texts = [
        *USUAL,
        *MARKERS,
        "aruco:5x7:35:5.25:dict_7x7_50",
        "charuco:6x4:20:14:DICT_APRILTAG_16h5",
        "aruco:2x2:9:1:DICT_ARUCO_ORIGINAL",
    ]
    for text, marker in zip(texts, run("return argument.map(live.markers.parseMarker);", argument=texts), strict=True):
        spec = parse_marker(text)
        assert (marker["kind"], marker["columns"], marker["rows"]) == (spec.kind, spec.columns, spec.rows)
        for name in ("is_coloured", "points_are_tags"):
            assert marker[name] == getattr(spec, name)
        assert marker["first_is_light"] != spec.first_is_dark
        assert (marker["square_mm"], marker["pitch_mm"]) == (spec.square_mm, spec.pitch_mm)
        assert (marker["width_mm"], marker["height_mm"]) == pytest.approx((spec.width_mm, spec.height_mm))
        assert marker["bits"] == (spec.cells - 2 if isinstance(spec, TagBoard) else 0)
    refused = """
      const isRead = (text) => { try { live.markers.parseMarker(text); return true; } catch { return false; } };
      return argument.map(isRead);
    """
    assert (
        run(refused, argument=["", "plain", "plain:9x7", "other:9x7:11", "aruco:5x7:35", "plain:9x7:11:5:DICT_4X4_50"])
        == [False] * 6
    )


def test_worker_answers_the_newest_frame_that_waits_and_guides_to_the_second_view(run):
    first, corners = frame_of(PLAIN, look_at(0, 40, 420))
    second, _ = frame_of(PLAIN, look_at(6, 40, 420))
    script = """
      const worker = new Worker("/frame_worker.js", { type: "module" });
      const answers = [];
      let wake = null;
      worker.onmessage = ({ data }) => { answers.push(data); wake?.(); };
      const heard = (count) => new Promise((resolve) => { wake = () => answers.length >= count && resolve(); wake(); });
      const rgba = ({ gray }) => Uint8ClampedArray.from({ length: 4 * gray.length }, (_, i) => gray[i >> 2]);
      const [first, second] = frames;
      const send = (frame, more) => worker.postMessage({ ...frame, marker: "plain:9x7:11", first: null, ...more });
      send({ width: 640, height: 480, pixels: rgba(first) }, { id: 1 });
      await heard(1);
      for (let id = 2; id <= 9; id += 1) send({ width: 640, height: 480, pixels: first.gray.slice() }, { id });
      await new Promise((resolve) => { wake = () => answers.at(-1).id === 9 && resolve(); wake(); });
      const count = answers.length;
      worker.postMessage({ reset: true });
      const view = { corners: argument, width: 640, height: 480 };
      send({ width: 640, height: 480, pixels: second.gray.buffer }, { id: 10, first: view });
      await heard(count + 1);
      worker.terminate();
      return [count, answers[0], answers.at(-1)];
    """
    count, alone, guided = run(script, [first, second], corners.tolist())
    assert count < 9  # frames that came while another was looked at are dropped
    assert (alone["advice"], alone["angle_deg"], alone["id"]) == ("good", None, 1)
    assert alone["tilt_deg"] == pytest.approx(40, abs=1)
    assert corner_errors(alone["board"], corners).max() < 0.5
    assert (guided["advice"], guided["side"], guided["id"]) == ("move_right", "right", 10)
    assert guided["angle_deg"] == pytest.approx(3.9, abs=0.5)
