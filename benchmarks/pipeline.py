"""How long the pipeline takes on one thread, stage by stage, against plain OpenCV calls; and how much memory.

    python benchmarks/pipeline.py [--scenes paper6] [--method NAME] [--calibrated] [--refusals]
        [--growth 200] [--data FOLDER]

Each pair: `tada estimate --json` in a fresh process, then the yardstick accuracy/floor.py, in turn, since the machine's
speed changes from minute to minute: only ratios of one run compare. FOLDER (default: TADA_SHARED_DATA, or ../shared)
holds accuracy/floor.py and scenes/dev/.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
WARM_UP_SHARE = 0.2  # of the repeated pairs: until then caches and the allocator fill
MB = 1024 * 1024
OTHER_MARKERS = (  # than the development scenes', of each kind
    "plain:10x8:10",
    "plain:6x5:20",
    "aruco:5x7:35:5:DICT_6X6_250",
    "charuco:5x7:30:22:DICT_4X4_50",
)


@dataclass(frozen=True)
class Scene:
    """A rendered pair: its folder and what `tada estimate` has to be told."""

    folder: Path
    marker: str
    camera: dict[str, Any]


@dataclass(frozen=True)
class Run:
    """One estimate in a fresh process. stages, seconds: as it tells them. peak_mb: of the whole process."""

    stages: dict[str, float]
    seconds: float
    peak_mb: float
    failure: str | None


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--scenes", default="paper6", help="folder under scenes/dev, or a folder of scenes"
    )
    parser.add_argument("--method", help="the default method unless named")
    parser.add_argument(
        "--calibrated", action="store_true", help="give the true camera; else EXIF only"
    )
    parser.add_argument(
        "--growth", type=int, default=0, metavar="N", help="also repeat N pairs in one process"
    )
    parser.add_argument(
        "--refusals", action="store_true", help="also each pair with other markers than its own"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    parser.add_argument("--limit", type=int, help="only the first so many scenes")
    parser.add_argument("--in-one-process", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    scenes = find_scenes(options.data, options.scenes)[: options.limit]
    if not scenes:
        print(
            f"There are no scenes in {options.scenes}: give --data FOLDER or set TADA_SHARED_DATA.",
            file=sys.stderr,
        )
        return 2
    if options.in_one_process:
        print(json.dumps(resident_mb_over(options.in_one_process, scenes, options)))
        return 0
    floor = options.data / "accuracy" / "floor.py"
    if not floor.is_file():
        print(f"There is no {floor}: times stand without the yardstick's.", file=sys.stderr)
    print_times(scenes, options, floor if floor.is_file() else None)
    if options.refusals:
        print_refusals(scenes, options)
    if options.growth:
        print_growth(options)
    return 0


def find_scenes(data: Path, name: str) -> list[Scene]:
    folder = Path(name) if Path(name).is_dir() else data / "scenes" / "dev" / name
    found = []
    for path in sorted(folder.glob("*/truth.json")):
        truth = json.loads(path.read_text())
        m, c = truth["marker"], truth["camera"]
        camera = {
            "width": c["width"],
            "height": c["height"],
            "fx": c["f"],
            "fy": c["f"],
            "cx": c["cx"],
            "cy": c["cy"],
        }
        camera["distortion"] = c["distortion"]
        found.append(
            Scene(path.parent, f"{m['kind']}:{m['cols']}x{m['rows']}:{m['square_mm']:g}", camera)
        )
    return found


def print_times(
    scenes: Sequence[Scene], options: argparse.Namespace, floor: Path | None
) -> tuple[float, float]:
    """Print a row a scene; the median ratio to the yardstick (NaN without one), and the largest peak memory, MB."""
    runs, ratios = [], []
    names: list[str] = []
    for scene in scenes:
        run = estimate(scene, options)
        yardstick = floor_seconds(floor, scene) if floor else None
        runs.append(run)
        if not names:
            names = list(run.stages)
            print(f"{'scene':<20}" + "".join(f"{name:>10}" for name in names), end="")
            print(f"{'seconds':>10}{'floor':>8}{'ratio':>7}{'peak MB':>9}")
        cells = "".join(f"{run.stages.get(name, float('nan')):>10.3f}" for name in names)
        ratio = run.seconds / yardstick if yardstick else float("nan")
        ratios.append(ratio)
        print(f"{scene.folder.name:<20}{cells}{run.seconds:>10.3f}", end="")
        print(
            f"{yardstick or float('nan'):>8.3f}{ratio:>7.2f}{run.peak_mb:>9.0f}  {run.failure or ''}",
            flush=True,
        )
    medians = "".join(
        f"{statistics.median(run.stages.get(name, float('nan')) for run in runs):>10.3f}"
        for name in names
    )
    seconds = statistics.median(run.seconds for run in runs)
    print(
        f"{'median':<20}{medians}{seconds:>10.3f}{'':>8}{statistics.median(ratios):>7.2f}", end=""
    )
    peak_mb = max(run.peak_mb for run in runs)
    print(f"{peak_mb:>9.0f}  (peak: the largest)")
    return statistics.median(ratios), peak_mb


def print_refusals(scenes: Sequence[Scene], options: argparse.Namespace) -> None:
    """The slowest refusal of each pair beside its measurement: none should take longer."""
    print(f"{'refused':<20}{'seconds':>10}{'measured':>10}{'ratio':>7}  marker announced: code")
    for scene in scenes:
        measured = estimate(scene, options)
        refused = [
            (estimate(replace(scene, marker=marker), options), marker) for marker in OTHER_MARKERS
        ]
        slowest, marker = max(refused, key=lambda each: each[0].seconds)
        print(f"{scene.folder.name:<20}{slowest.seconds:>10.3f}{measured.seconds:>10.3f}", end="")
        print(
            f"{slowest.seconds / measured.seconds:>7.2f}  {marker}: {slowest.failure}", flush=True
        )


def estimate(scene: Scene, options: argparse.Namespace) -> Run:
    """One `tada estimate` in its own process, with that process's peak memory."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "app.cli", "estimate", "--json", "--marker", scene.marker]
        if options.calibrated:
            camera = Path(folder) / "camera.json"
            camera.write_text(json.dumps(scene.camera))
            command += ["--camera", str(camera)]
        if options.method:
            command += ["--method", options.method]
        command += [str(scene.folder / "left.jpg"), str(scene.folder / "right.jpg")]
        output = Path(folder) / "answer.json"
        environment = os.environ | ONE_THREAD
        with output.open("wb") as stream:
            process = subprocess.Popen(command, stdout=stream, cwd=ROOT, env=environment)
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in {0, 1}:
            raise SystemExit(
                f"tada estimate ended with {process.returncode} on {scene.folder.name}."
            )
        answer = json.loads(output.read_text())
    failure = answer["failure"]["code"] if answer["failure"] else None
    return Run(answer["stages"], answer["seconds"], usage.ru_maxrss / 1024, failure)


def floor_seconds(floor: Path, scene: Scene) -> float:
    command = [
        sys.executable,
        str(floor),
        str(scene.folder / "left.jpg"),
        str(scene.folder / "right.jpg"),
    ]
    done = subprocess.run(command, check=True, capture_output=True, env=os.environ | ONE_THREAD)
    return float(json.loads(done.stdout)["total"])


def print_growth(options: argparse.Namespace) -> None:
    """Resident memory of one process over many pairs, after the first fifth and at the end."""
    command = [
        sys.executable,
        __file__,
        "--in-one-process",
        str(options.growth),
        "--scenes",
        options.scenes,
    ]
    command += ["--data", str(options.data)]
    command += ["--method", options.method] if options.method else []
    command += ["--calibrated"] if options.calibrated else []
    command += ["--limit", str(options.limit)] if options.limit else []
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, check=True, capture_output=True, env=environment)
    resident = json.loads(done.stdout)
    early, late = resident[int(WARM_UP_SHARE * len(resident))], resident[-1]
    print(
        f"memory over {len(resident)} pairs: {early:.0f} MB after a fifth, {late:.0f} MB at the end,",
        end=" ",
    )
    print(f"{late - early:+.1f} MB")


def resident_mb_over(
    count: int, scenes: Sequence[Scene], options: argparse.Namespace
) -> list[float]:
    """Resident memory, MB, after each of so many estimates, the scenes in turn."""
    from app.meals.estimate.estimate_json import options_from_json  # noqa: PLC0415
    from app.meals.estimate.run_estimate import run_estimate  # noqa: PLC0415  # only this child process needs it

    page = os.sysconf("SC_PAGE_SIZE")
    resident = []
    for index in range(count):
        scene = scenes[index % len(scenes)]
        told = {
            "marker": scene.marker,
            "camera": scene.camera if options.calibrated else None,
            "hints": [],
        }
        if options.method:
            told["method"] = options.method
        run_estimate(
            {side: scene.folder / f"{side}.jpg" for side in ("left", "right")},
            options_from_json(told),
            max_pixels=10**8,
            on_stage=lambda _: None,
            want_artefacts=False,
        )
        resident.append(int(Path("/proc/self/statm").read_text().split()[1]) * page / MB)
    return resident


if __name__ == "__main__":
    raise SystemExit(main())
