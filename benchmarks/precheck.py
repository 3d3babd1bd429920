"""How long a pair's pre-check takes in a warm child, in seconds and against decoding both JPEGs in full by OpenCV.

    python benchmarks/precheck.py [--scenes meals] [--repeat 3] [--data FOLDER]

Each pair is checked as POST /v1/checks does it, without the upload: through the API's own pool of one child. Beside it
stands what the check takes when the right photograph shows no board, and when another board was announced. The
yardstick is run right before each, on one thread, since the machine's speed changes from minute to minute. FOLDER
(default: TADA_SHARED_DATA, or ../shared) holds scenes/dev/.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.children.api_children import ApiChildren, Whose  # noqa: E402  # found from the checkout, installed or not
from app.core.settings import Settings  # noqa: E402
from benchmarks.pipeline import Scene, find_scenes  # noqa: E402

OTHER_BOARD = "aruco:5x7:35:5:DICT_6X6_250"  # of tags, where checkerboards lie


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", default="meals", help="folder under scenes/dev")
    parser.add_argument("--repeat", type=int, default=3, help="the quickest of so many counts")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    options = parser.parse_args(arguments)
    scenes = find_scenes(options.data, options.scenes)
    if not scenes:
        print(
            f"There are no scenes in {options.scenes}: give --data FOLDER or set TADA_SHARED_DATA.",
            file=sys.stderr,
        )
        return 2
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as name:
        children = ApiChildren(Settings(data_dir=Path(name)))
        try:
            print_times(children, scenes, options.repeat, Path(name))
        finally:
            children.close()
    return 0


def print_times(
    children: ApiChildren, scenes: Sequence[Scene], repeat: int, folder: Path
) -> tuple[float, float, float]:
    """Print a row a pair; the medians of what checks take: as announced, without a board, another one announced.

    As ratios to decoding.
    """
    check(children, scenes[0], scenes[0].folder / "right.jpg")  # the child starts
    print(
        f"{'pair':<20} {'MP':>5} {'decode s':>9} {'check s':>9} {'ratio':>6} {'no board s':>11} {'ratio':>6}"
        f" {'other s':>9} {'ratio':>6}  problems"
    )
    rows = []
    for scene in scenes:
        pair = [scene.folder / f"{side}.jpg" for side in ("left", "right")]
        bare = folder / "bare.jpg"
        bare.write_bytes(without_board(pair[1]))
        other = replace(scene, marker=OTHER_BOARD)
        decode, checked, absent, announced, problems = [], [], [], [], []
        for _ in range(repeat):
            decode.append(timed(lambda pair=pair: [cv2.imread(str(path)) for path in pair]))
            started = time.perf_counter()
            problems = check(children, scene, pair[1])
            checked.append(time.perf_counter() - started)
            absent.append(timed(lambda scene=scene, bare=bare: check(children, scene, bare)))
            announced.append(
                timed(lambda scene=other, right=pair[1]: check(children, scene, right))
            )
        height, width = cv2.imread(str(pair[0])).shape[:2]
        row = min(decode), min(checked), min(absent), min(announced)
        rows.append(row)
        codes = ", ".join(problems) or "none"
        print(
            f"{scene.folder.name:<20} {height * width / 1e6:5.1f} {row[0]:9.3f} {row[1]:9.3f} {row[1] / row[0]:6.2f}"
            f" {row[2]:11.3f} {row[2] / row[0]:6.2f} {row[3]:9.3f} {row[3] / row[0]:6.2f}  {codes}"
        )
    decode_s, check_s, absent_s, other_s = (
        statistics.median(column) for column in zip(*rows, strict=True)
    )
    print(
        f"{'median':<20} {'':>5} {decode_s:9.3f} {check_s:9.3f} {check_s / decode_s:6.2f} {absent_s:11.3f}"
        f" {absent_s / decode_s:6.2f} {other_s:9.3f} {other_s / decode_s:6.2f}"
    )
    slowest = [max(column) for column in zip(*rows, strict=True)]
    print(
        f"slowest: {slowest[1]:.3f} s, without a board {slowest[2]:.3f} s, another board {slowest[3]:.3f} s"
    )
    return check_s / decode_s, absent_s / decode_s, other_s / decode_s


def check(children: ApiChildren, scene: Scene, right: Path) -> list[str]:
    answer = children.run(
        "check",
        {
            "left": str(scene.folder / "left.jpg"),
            "right": str(right),
            "marker": scene.marker,
            "camera": None,
            "max_pixels": 60_000_000,
        },
        seconds=30.0,
        whose=Whose(None, None),
    )
    return [f"{problem['code']} ({problem['severity']})" for problem in answer["problems"]]


def without_board(path: Path) -> bytes:
    """The photograph turned upside down in quarters: as rich, and no board is whole any more."""
    pixels = cv2.imread(str(path))
    height, width = pixels.shape[:2]
    size = 64
    rows, columns = height // size, width // size
    tiles = pixels[: rows * size, : columns * size].reshape(rows, size, columns, size, 3)
    turned = tiles[:, ::-1, :, ::-1].reshape(rows * size, columns * size, 3)
    return bytes(
        cv2.imencode(".jpg", np.ascontiguousarray(turned), [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    )


def timed(work: object) -> float:
    started = time.perf_counter()
    work()  # type: ignore[operator]
    return time.perf_counter() - started


if __name__ == "__main__":
    raise SystemExit(main())
