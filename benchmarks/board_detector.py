"""Accuracy and speed of the capture page's live help: its own modules in node, on frames of 640 px.

    python benchmarks/board_detector.py [--repeat 3] [--data FOLDER]

Frames are made from the development photographs that show a marker (scenes/dev, photos/chessboards, photos/real_pairs)
and changed as a hand and a kitchen change them; their corners are compared with those that the server finds in the
whole photograph, angles between left and right with the scenes' true ones. Photographs without a board, crops of scenes
beside theirs, and chequered cloth, which is adversarial, are searched for a board of each kind. FOLDER (default:
TADA_SHARED_DATA, or ../shared) holds scenes/ and photos/. Needs node 20 or newer.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.vision.board.marker import contrast_image, find_marker  # noqa: E402  # importable once the checkout is on the path
from app.vision.marker_spec import parse_marker  # noqa: E402
from app.vision.model import MarkerObservation, Photo  # noqa: E402
from app.vision.photograph.photo import read_photo  # noqa: E402

LIVE = ROOT / "app" / "capture" / "static" / "live"
LONG_SIDE_PX = 640
MAX_PIXELS = 10**8
CHESSBOARDS = "plain:10x7:25"
SHEET = "aruco:5x7:35:5:DICT_6X6_250"
EACH_KIND = ("plain:9x7:11", "colour:4x5:12", "charuco:6x4:20:14:DICT_4X4_50", SHEET)
FOODS_TAKEN = 3  # every third of the photographs of foods
RUN = """
import fs from "node:fs";
import { findBoard } from "./board_detector.js";
import { viewAngle } from "./view_angle.js";
const { frames, repeat } = JSON.parse(fs.readFileSync("frames.json"));
const boards = {};
for (const { name, file, width, height, marker, first } of frames) {
  const gray = new Uint8Array(fs.readFileSync(file));
  let [board, ms] = [null, Infinity];
  for (let round = 0; round < repeat; round += 1) {
    const before = process.cpuUsage();
    board = findBoard(gray, width, height, marker);
    const { user, system } = process.cpuUsage(before);
    ms = Math.min(ms, (user + system) / 1000);
  }
  const view = board === null ? null : { corners: board.corners, width, height };
  boards[name] = { board, view, ms };
  const other = boards[first]?.view;
  if (view !== null && other) boards[name].angle = viewAngle(other, view, marker);
}
fs.writeFileSync("boards.json", JSON.stringify(boards));
"""


@dataclass(frozen=True)
class Frame:
    """A preview frame. pixels: (h, w, 3) BGR. corners_px: (n, 2) that the server finds in the photograph, in the frame.

    first: name of the pair's first frame; angle_deg: true angle to it.
    """

    name: str
    pixels: np.ndarray
    marker: str
    corners_px: np.ndarray | None = None
    first: str | None = None
    angle_deg: float | None = None


@dataclass
class Answers:
    """The detector's answers to a group of frames, by their names."""

    frames: Sequence[Frame]
    boards: dict[str, dict[str, Any]] = field(default_factory=dict)

    def of(self, frame: Frame) -> dict[str, Any]:
        """board, angle, ms."""
        return self.boards[frame.name]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=3, help="the quickest of so many counts")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    options = parser.parse_args(arguments)
    if shutil.which("node") is None:
        print("There is no node on this machine: nothing was measured.", file=sys.stderr)
        return 2
    scenes = list(scene_frames(options.data))
    frames = [*scenes, *real_frames(options.data)]
    if not frames:
        print(
            "There are no photographs: give --data FOLDER or set TADA_SHARED_DATA.", file=sys.stderr
        )
        return 2
    print(
        f"{'frames':<28} {'of':>4} {'found':>6} {'whole':>6} {'corner px':>10} {'worst':>6} {'ms':>6} {'p95':>6}"
    )
    answers = detect(frames, options.repeat)
    print_found("development photographs", answers)
    for name, change in CHANGES.items():
        print_found(name, detect([changed(frame, change) for frame in frames], 1), list_all=False)
    print_angles(answers)
    empty = list(frames_without_board(options.data, scenes))
    for name, group in (("without a board", empty), ("chequered cloth", list(cloths()))):
        for marker in EACH_KIND:
            print_false(
                f"{name}, {marker.split(':')[0]}",
                detect([announced(frame, marker) for frame in group], 1),
            )
    return 0


def scene_frames(data: Path) -> Iterator[Frame]:
    """All views of the development scenes with a marker."""
    for truth_file in sorted((data / "scenes" / "dev").glob("*/*/truth.json")):
        truth = json.loads(truth_file.read_text())
        printed = truth["marker"]
        if printed["kind"] == "none":
            continue
        marker = f"{printed['kind']}:{printed['cols']}x{printed['rows']}:{printed['square_mm']:.6g}"
        if "dictionary" in printed:
            second_mm = (
                printed["separation_mm"] if printed["kind"] == "aruco" else printed["marker_mm"]
            )
            marker += f":{second_mm:g}:{printed['dictionary']}"
        poses = truth["poses_world_to_camera"]
        first = next(iter(poses))
        for view in poses:
            frame = seen_frame(
                f"{truth_file.parent.name} {view}", truth_file.parent / f"{view}.jpg", marker
            )
            if view == first:
                yield frame
                continue
            angle_deg = true_angle_deg(poses[first], poses[view], printed["centre"])
            yield Frame(
                frame.name,
                frame.pixels,
                marker,
                frame.corners_px,
                f"{truth_file.parent.name} {first}",
                angle_deg,
            )


def true_angle_deg(first: dict[str, Any], second: dict[str, Any], centre: Sequence[float]) -> float:
    """Angle between two cameras as seen from the board's middle, degrees."""
    sights = []
    for pose in (first, second):
        rotation, shift = np.array(pose["R"]), np.array(pose["t_mm"])
        sight = -rotation.T @ shift - [*centre[:2], 0.0]
        sights.append(sight / np.linalg.norm(sight))
    return float(np.degrees(np.arccos(np.clip(sights[0] @ sights[1], -1, 1))))


def real_frames(data: Path) -> Iterator[Frame]:
    """Real photographs of checkerboards, of a sheet of tags, and those with a card drawn in."""
    for path in sorted((data / "photos" / "chessboards").glob("*.jpg")):
        yield seen_frame(path.stem, path, CHESSBOARDS)
    for path in sorted((data / "photos" / "real_pairs").glob("*.jpg")):
        if path.stem.endswith("_card"):
            yield seen_frame(path.stem, path, EACH_KIND[0])
        elif path.stem.startswith("box_"):
            yield seen_frame(path.stem, path, SHEET)


def seen_frame(name: str, path: Path, marker: str) -> Frame:
    photo = read_photo(path.read_bytes(), max_pixels=MAX_PIXELS)
    if not isinstance(photo, Photo):
        raise TypeError(f"{path} is no photograph: {photo}")
    seen = find_marker(photo, parse_marker(marker))
    small = reduced(photo.pixels_bgr)
    if not isinstance(seen, MarkerObservation):
        return Frame(name, small, marker)
    scale = np.array(small.shape[1::-1]) / photo.pixels_bgr.shape[1::-1]
    return Frame(name, small, marker, (seen.corners_px + 0.5) * scale - 0.5)


def reduced(pixels: np.ndarray, long_side_px: int = LONG_SIDE_PX) -> np.ndarray:
    height, width = pixels.shape[:2]
    scale = long_side_px / max(height, width)
    if scale >= 1:
        return pixels
    size = (round(width * scale), round(height * scale))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))


def with_noise(pixels: np.ndarray, deviation: float) -> np.ndarray:
    noise = np.random.default_rng(1).normal(0, deviation, pixels.shape)
    return np.clip(np.rint(pixels + noise), 0, 255).astype(np.uint8)


def moved_blur(pixels: np.ndarray) -> np.ndarray:
    kernel = np.full((1, 5), 0.2)
    return np.asarray(cv2.filter2D(pixels, -1, kernel))


def tilted(pixels: np.ndarray) -> np.ndarray:
    """The frame as if it were seen some 30 degrees flatter."""
    height, width = pixels.shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    there = np.array(
        [
            [0.15 * width, 0.2 * height],
            [0.85 * width, 0.2 * height],
            [width, 0.9 * height],
            [0, 0.9 * height],
        ]
    )
    matrix = cv2.getPerspectiveTransform(corners, there.astype(np.float32))
    return np.asarray(
        cv2.warpPerspective(pixels, matrix, (width, height), borderValue=(90, 100, 110))
    )


CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "portrait": np.rot90,
    "upside down": lambda pixels: np.rot90(pixels, 2),
    "turned by 30 degrees": lambda pixels: turned(pixels, 30),
    "tilted": tilted,
    "out of focus, 1.5 px": lambda pixels: cv2.GaussianBlur(pixels, (0, 0), 1.5),
    "moved by 5 px": moved_blur,
    "a quarter of the light": lambda pixels: with_noise(0.25 * pixels, 3),
    "overexposed by a stop": lambda pixels: np.clip(1.6 * pixels.astype(np.float64), 0, 255).astype(
        np.uint8
    ),
    "grain of 10 levels": lambda pixels: with_noise(pixels, 10),
    "JPEG of quality 40": lambda pixels: cv2.imdecode(
        cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 40])[1], cv2.IMREAD_COLOR
    ),
    "480 px": lambda pixels: reduced(pixels, 480),
}


def turned(pixels: np.ndarray, angle_deg: float) -> np.ndarray:
    height, width = pixels.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), angle_deg, 0.8)
    return np.asarray(cv2.warpAffine(pixels, matrix, (width, height), borderValue=(90, 100, 110)))


def changed(frame: Frame, change: Callable[[np.ndarray], np.ndarray]) -> Frame:
    return Frame(frame.name, np.ascontiguousarray(change(frame.pixels)), frame.marker)


def announced(frame: Frame, marker: str) -> Frame:
    return Frame(frame.name, frame.pixels, marker)


def frames_without_board(data: Path, scenes: Sequence[Frame]) -> Iterator[Frame]:
    """Photographs of foods, objects and scenes without a marker, and the largest part of a scene beside its own."""
    paths = sorted((data / "photos" / "ecustfd" / "images").glob("*"))[::FOODS_TAKEN]
    paths += [
        path
        for path in (data / "photos" / "real_pairs").glob("rig_*.jpg")
        if "card" not in path.stem
    ]
    paths += [
        *(data / "photos").glob("aloe[LR].jpg"),
        *(data / "scenes" / "dev" / "rigs").glob("*/*.jpg"),
    ]
    for path in paths:
        pixels = cv2.imread(str(path))
        if pixels is not None:
            yield Frame(f"{path.parent.name} {path.stem}", reduced(pixels), EACH_KIND[0])
    for frame in scenes:
        if frame.corners_px is not None:
            yield Frame(
                f"beside {frame.name}", beside_board(frame.pixels, frame.corners_px), EACH_KIND[0]
            )


def beside_board(pixels: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """The largest part of a frame that lies above, below, left or right of the board and its margin."""
    height, width = pixels.shape[:2]
    margin = 0.35 * np.ptp(corners_px, axis=0).max()
    left, top = np.clip(corners_px.min(axis=0) - margin, 0, [width, height]).astype(int)
    right, bottom = np.clip(corners_px.max(axis=0) + margin, 0, [width, height]).astype(int)
    parts = [pixels[:, :left], pixels[:, right:], pixels[:top], pixels[bottom:]]
    return np.ascontiguousarray(max(parts, key=lambda part: part.size))


def cloths() -> Iterator[Frame]:
    """Chequered cloth and gingham seen from the side, squares of 8 to 60 px, half of them beneath a white plate."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:1200, :1600].astype(np.float64)
    for index in range(40):
        side = rng.uniform(8, 60)
        wave = rng.uniform(0, 4)
        u, v = (x + wave * np.sin(y / 90)) // side, (y + wave * np.sin(x / 110)) // side
        gingham = np.choose(((u % 2) + (v % 2)).astype(int), [225, 140, 60])
        cloth = np.where((u + v) % 2 == 0, 50, 220) if index % 2 else gingham
        pixels = np.repeat(cloth[..., None], 3, axis=2).astype(np.uint8)
        if index % 4 >= 2:
            cv2.ellipse(pixels, (800, 620), (420, 380), 0, 0, 360, (240, 240, 240), -1)
        yield Frame(
            f"cloth {index}",
            reduced(with_noise(turned(tilted(pixels), rng.uniform(-40, 40)), 3)),
            EACH_KIND[0],
        )


def detect(frames: Sequence[Frame], repeat: int) -> Answers:
    """Run the page's modules on frames in node, the quickest of `repeat` runs each."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for module in LIVE.glob("*.js"):
            shutil.copy(module, folder)
        (folder / "package.json").write_text('{"type": "module"}')
        (folder / "run.js").write_text(RUN)
        rows = []
        for index, frame in enumerate(frames):
            gray = contrast_image(frame.pixels, is_coloured=parse_marker(frame.marker).is_coloured)
            gray.tofile(folder / f"{index}.gray")
            row = {
                "name": frame.name,
                "file": f"{index}.gray",
                "marker": frame.marker,
                "first": frame.first,
            }
            rows.append(row | {"width": gray.shape[1], "height": gray.shape[0]})
        (folder / "frames.json").write_text(json.dumps({"frames": rows, "repeat": repeat}))
        subprocess.run(["node", "run.js"], cwd=folder, check=True)
        return Answers(frames, json.loads((folder / "boards.json").read_text()))


def print_found(name: str, answers: Answers, *, list_all: bool = True) -> None:
    boards = [(frame, answers.of(frame)["board"]) for frame in answers.frames]
    seen = [(frame, board) for frame, board in boards if board is not None]
    errors = [
        corner_error_px(board["points"], frame.corners_px)
        for frame, board in seen
        if frame.corners_px is not None
    ]
    whole = sum(board["is_whole"] for _, board in seen)
    middle, worst = (
        (f"{statistics.median(errors):.3f}", f"{max(errors):.2f}") if errors else ("", "")
    )
    times = sorted(answers.of(frame)["ms"] for frame in answers.frames)
    print(
        f"{name:<28} {len(boards):>4} {len(seen):>6} {whole:>6} {middle:>10} {worst:>6}"
        f" {statistics.median(times):>6.1f} {times[int(0.95 * len(times))]:>6.1f}"
    )
    missed = [frame.name for frame, board in boards if board is None]
    if missed:
        listed = missed if list_all else missed[:12]
        print(f"  missed: {', '.join(listed)}{' ...' if len(listed) < len(missed) else ''}")


def corner_error_px(points: Sequence[Sequence[float]], corners_px: np.ndarray) -> float:
    """Median over the detector's points of the distance to the nearest of the server's."""
    apart = np.linalg.norm(np.array(points)[:, None] - corners_px, axis=-1).min(axis=1)
    return float(np.median(apart))


def print_angles(answers: Answers) -> None:
    off = []
    for frame in answers.frames:
        angle = answers.of(frame).get("angle")
        if frame.angle_deg is not None and angle is not None:
            off.append((abs(angle["angle_deg"] - frame.angle_deg), frame.name))
    off.sort()
    if off:
        median, high, worst = off[len(off) // 2][0], off[int(0.9 * len(off))][0], off[-1]
        print(
            f"angle between left and right, {len(off)} pairs: median {median:.2f}, 90th percentile {high:.2f}, "
            f"worst {worst[0]:.2f} degrees off ({worst[1]})"
        )


def print_false(name: str, answers: Answers) -> None:
    false = [frame.name for frame in answers.frames if answers.of(frame)["board"] is not None]
    times = sorted(answers.of(frame)["ms"] for frame in answers.frames)
    print(
        f"{name:<28} {len(answers.frames):>4} {len(false):>6} {'':>6} {'':>10} {'':>6}"
        f" {statistics.median(times):>6.1f} {times[int(0.95 * len(times))]:>6.1f}"
    )
    if false:
        print(f"  found: {', '.join(false[:12])}")


if __name__ == "__main__":
    raise SystemExit(main())
