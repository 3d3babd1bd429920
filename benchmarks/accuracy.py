"""How good the volumes are: the data's scorer over whole sets, methods and cameras, against the targets and Table I.

    python benchmarks/accuracy.py [--scenes SET_OR_FOLDER ...] [--method shape paper] [--camera calibrated exif]
                                  [--hints none|point|box|food] [--vessels] [--limit N] [--jobs N] [--markdown]
                                  [--json OUT] [--data FOLDER]

Every figure is the scorer's own (accuracy/score.py of FOLDER, by default TADA_SHARED_DATA or ../shared): it runs
`tada estimate` on each scene, and its summary is asked again over whatever is pooled. A folder's kind, which says what
targets hold for it, is its name up to a hyphen: meals-fresh is held against the targets of meals. The set real_pairs,
real photographs (real_pairs.py), has a table and targets of its own.
"""

import argparse
import contextlib
import functools
import importlib.util
import io
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks import real_pairs  # noqa: E402 - found from the root

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
SETS = ("paper6", "meals", "hard", "tables", "packs", "vessels")
REAL_PAIRS = "real_pairs"  # beside SETS: real photographs, under photos
METHODS = ("shape", "paper")
SCORER: dict[str, Any] = {
    "views": 2,
    "depth": "none",
    "no_marker": False,
    "timeout": 120,
}  # its options beside a Setting
CAMERAS = ("calibrated", "exif")
POOLED = "pooled"
JUDGED_METHOD = "shape"  # the default, which the targets are for
TABLE_I = {  # of the founding paper: true volume and its estimate, ml
    "apple": (185.0, 181.5),
    "orange": (118.0, 112.6),
    "pear": (230.0, 195.1),
    "banana": (155.0, 146.5),
    "pineapple": (1547.0, 1404.2),
    "kiwi": (120.0, 108.8),
}


@dataclass(frozen=True)
class Target:
    """What a figure of a kind of scenes (POOLED: of all) must be. least_items: with fewer the target is open."""

    kind: str
    camera: str
    figure: str
    least: float = float("-inf")
    most: float = float("inf")
    hints: str = "none"
    vessels: bool = False
    least_items: int = 1


TARGETS = (
    Target("paper6", "calibrated", "mape_percent", most=3.0),
    Target("paper6", "calibrated", "worst_percent", most=8.0),
    Target("paper6", "exif", "mape_percent", most=3.7),
    *(Target("meals", camera, "found_percent", least=100.0) for camera in CAMERAS),
    *(Target("meals", camera, "spurious", most=0) for camera in CAMERAS),
    Target("meals", "calibrated", "mape_percent", most=4.4),
    Target("meals", "calibrated", "median_percent", most=5.0),
    Target("meals", "exif", "mape_percent", most=5.0),
    Target("meals", "calibrated", "right_count_percent", least=100 * 14 / 16),
    Target("meals", "calibrated", "mean_iou", least=0.90),
    Target("meals", "calibrated", "mean_iou", least=0.93, hints="point"),
    *(Target("hard", camera, "found_percent", least=100.0) for camera in CAMERAS),
    Target("hard", "calibrated", "mape_percent", most=4.2),
    Target("hard", "exif", "mape_percent", most=4.4),
    Target("tables", "calibrated", "found_percent", least=95.0),
    Target("tables", "exif", "found_percent", least=93.0),
    Target("tables", "calibrated", "spurious_percent", most=2.0),
    Target("tables", "exif", "spurious_percent", most=3.0),
    Target("tables", "calibrated", "found_mape_percent", most=9.0),
    Target("tables", "exif", "found_mape_percent", most=10.0),
    Target("packs", "calibrated", "found_percent", least=90.0),
    Target("packs", "calibrated", "mape_percent", most=8.0),
    Target("packs", "exif", "mape_percent", most=10.0),
    Target("packs", "calibrated", "found_percent", least=100.0, hints="box"),
    Target("packs", "calibrated", "mape_percent", most=6.0, hints="box"),
    Target("packs", "exif", "mape_percent", most=8.0, hints="box"),
    Target("vessels", "calibrated", "mape_percent", most=12.0),
    Target("vessels", "exif", "mape_percent", most=14.0),
    Target("vessels", "calibrated", "mape_percent", most=6.0, vessels=True),
    Target("vessels", "exif", "mape_percent", most=8.0, vessels=True),
    Target(
        POOLED, "calibrated", "interval_coverage_percent", least=87.0, most=93.0, least_items=60
    ),
    Target(POOLED, "exif", "interval_coverage_percent", least=85.0, most=95.0, least_items=60),
    Target(POOLED, "calibrated", "interval_skill", least=0.20),
    Target(POOLED, "exif", "interval_skill", least=0.10),
    Target(POOLED, "calibrated", "log_slope", least=0.98, most=1.02),
    Target(POOLED, "exif", "log_slope", least=0.97, most=1.03),
    Target(POOLED, "calibrated", "bias_percent", least=-2.0, most=2.0),
    Target(POOLED, "exif", "bias_percent", least=-3.0, most=3.0),
)


@dataclass(frozen=True)
class SceneSet:
    """A folder of scenes, by the name that the tables give it."""

    name: str
    kind: str
    scenes: tuple[Path, ...]


@dataclass(frozen=True)
class Setting:
    """How a set was measured."""

    method: str
    camera: str
    hints: str
    vessels: bool = False


@dataclass(frozen=True)
class Scored:
    """The scorer's rows (one a true item) and its line on the scene, for one scene as measured in one way."""

    scene_set: SceneSet
    setting: Setting
    rows: list[dict[str, Any]]
    scene: dict[str, Any]


@dataclass(frozen=True)
class Table:
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments)
    path = options.data / "accuracy" / "score.py"
    sets = find_sets(options.data, options.scenes, options.limit)
    pairs = (
        real_pairs.real_pairs(options.data / "photos" / REAL_PAIRS)
        if REAL_PAIRS in options.scenes
        else []
    )
    if not path.is_file() or not (sets or pairs):
        print(
            f"There is no {path}, or no scene: give --data FOLDER or set TADA_SHARED_DATA.",
            file=sys.stderr,
        )
        return 2
    scorer = load_scorer(path)
    scored = score(scorer, sets, options)
    tables = tables_of(scorer, scored) if scored else []
    if pairs:
        tables.append(real_table(pairs[: options.limit], options))
    print(heading(options) + "\n")
    print(
        "\n\n".join(as_markdown(table) if options.markdown else as_text(table) for table in tables)
    )
    if options.json:
        options.json.write_text(
            json.dumps([raw for each in scored for raw in raw_rows(each)], indent=1)
        )
    return 0


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--scenes",
        nargs="+",
        default=[*SETS, REAL_PAIRS],
        help="sets under scenes/dev, or folders of scenes",
    )
    parser.add_argument("--method", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--camera", nargs="+", default=list(CAMERAS), choices=CAMERAS)
    parser.add_argument("--hints", default="none", choices=["none", "point", "box", "food"])
    parser.add_argument(
        "--vessels", action="store_true", help="each scene's vessels as a study's library"
    )
    parser.add_argument("--limit", type=int, help="only the first so many scenes of each set")
    parser.add_argument("--jobs", type=int, default=1, help="processes at once, one thread each")
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")
    parser.add_argument("--json", type=Path, metavar="OUT", help="keep the scorer's rows")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    return parser.parse_args(arguments)


def find_sets(data: Path, names: Sequence[str], limit: int | None) -> list[SceneSet]:
    """The sets that hold a scene. Two folders of one name are told apart by their paths."""
    folders = [
        Path(name) if Path(name).is_dir() else data / "scenes" / "dev" / name for name in names
    ]
    found = []
    for folder in folders:
        scenes = tuple(sorted(path.parent for path in folder.glob("*/truth.json"))[:limit])
        is_unique = sum(other.name == folder.name for other in folders) == 1
        name = folder.name if is_unique else str(folder)
        found.append(SceneSet(name, folder.name.split("-")[0], scenes))
    return [each for each in found if each.scenes]


def load_scorer(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("score", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is no Python module.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def score(
    scorer: ModuleType, sets: Sequence[SceneSet], options: argparse.Namespace
) -> list[Scored]:
    """Every scene in every way, as the scorer measures it: each estimate in a process of its own."""
    settings = [
        Setting(method, camera, options.hints, options.vessels)
        for method in options.method
        for camera in options.camera
    ]
    tasks = [
        (each, scene, setting) for setting in settings for each in sets for scene in each.scenes
    ]

    def measured(task: tuple[SceneSet, Path, Setting]) -> Scored:
        scene_set, scene, setting = task
        command = f"{sys.executable} -m app.cli estimate"
        rows, summary = scorer.run_scene(
            scene, argparse.Namespace(command=command, **SCORER, **vars(setting))
        )
        errors = ", ".join(
            "not found" if row["error"] is None else f"{100 * row['error']:+.1f} %" for row in rows
        )
        print(
            f"{scene_set.name} {scene.name} {setting.method} {setting.camera}: {errors}",
            file=sys.stderr,
        )
        return Scored(scene_set, setting, rows, summary)

    environment = mock.patch.dict(os.environ, ONE_THREAD | {"PYTHONPATH": str(ROOT)})
    with environment, ThreadPoolExecutor(options.jobs) as pool:
        return list(pool.map(measured, tasks))


def summarise(scorer: ModuleType, scored: Sequence[Scored]) -> dict[str, Any]:
    """The scorer's summary over these scenes, by its own main, which is handed what was measured before.

    Added to it: found_percent, right_count_percent, spurious_percent (of the true items), and found_mape_percent, of
    the items that were found.
    """
    measured = {f"{number:06d}": (each.rows, each.scene) for number, each in enumerate(scored)}
    with tempfile.TemporaryDirectory() as folder:
        for name in measured:
            (Path(folder) / name).mkdir()
            (Path(folder) / name / "truth.json").touch()
        output = Path(folder) / "summary.json"
        with (
            mock.patch.object(scorer, "run_scene", lambda scene, _: measured[scene.name]),
            mock.patch.object(sys, "argv", ["score.py", folder, "--json", str(output)]),
            contextlib.redirect_stdout(io.StringIO()),
        ):
            scorer.main()
        summary: dict[str, Any] = json.loads(output.read_text())["summary"]
    summary["found_percent"] = 100 * summary["found"] / summary["items"]
    errors = [abs(row["error"]) for each in scored for row in each.rows if row["error"] is not None]
    summary["found_mape_percent"] = 100 * sum(errors) / len(errors) if errors else None
    summary["spurious_percent"] = 100 * summary["spurious"] / summary["items"]
    summary["right_count_percent"] = 100 * summary["count_correct"] / summary["scenes"]
    return summary


def tables_of(scorer: ModuleType, scored: Sequence[Scored]) -> list[Table]:
    settings = list(dict.fromkeys(each.setting for each in scored))
    sets = list(dict.fromkeys(each.scene_set for each in scored))
    summaries = {
        (scene_set, setting): summarise(
            scorer,
            [each for each in scored if each.scene_set == scene_set and each.setting == setting],
        )
        for scene_set, setting in itertools.product(sets, settings)
    }
    pooled = {
        setting: summarise(scorer, [each for each in scored if each.setting == setting])
        for setting in settings
    }
    judged = [
        (scene_set.name, scene_set.kind, setting, found)
        for (scene_set, setting), found in summaries.items()
    ]
    judged += [(POOLED, POOLED, setting, found) for setting, found in pooled.items()]
    return [
        set_table(
            (scene_set.name, setting, found) for (scene_set, setting), found in summaries.items()
        ),
        fruit_table([each for each in scored if each.scene_set.kind == "paper6"]),
        pooled_table(pooled),
        bar_table(judged),
    ]


def real_table(pairs: Sequence[real_pairs.RealPair], options: argparse.Namespace) -> Table:
    """Real photographs by method and camera, against their targets; refused pairs are counted apart."""
    command = f"{sys.executable} -m app.cli estimate"
    rows = []
    for method, camera in itertools.product(options.method, options.camera):
        measure = functools.partial(
            real_pairs.measure, command=command, camera=camera, method=method
        )
        environment = mock.patch.dict(os.environ, ONE_THREAD | {"PYTHONPATH": str(ROOT)})
        with environment, ThreadPoolExecutor(options.jobs) as pool:
            s = real_pairs.summarise(list(pool.map(measure, pairs)))
        if not s["measured"]:
            rows.append((method, camera, f"0 of {s['pairs']}", *["-"] * 6))
            continue
        low, high = real_pairs.COVERAGE_PERCENT
        is_met = (
            s["mean_error"] <= real_pairs.MOST_MEAN_ERROR_PERCENT and low <= s["coverage"] <= high
        )
        figures = (f"{s[key]:.1f} %" for key in ("mean_error", "median_error", "worst"))
        verdict_words = ("met" if is_met else "MISSED") if method == JUDGED_METHOD else ""
        measured = f"{s['measured']} of {s['pairs']}"
        rows.append(
            (
                method,
                camera,
                measured,
                *figures,
                f"{s['bias']:+.1f} %",
                f"{s['coverage']:.0f} %",
                verdict_words,
            )
        )
    low, high = real_pairs.COVERAGE_PERCENT
    targets = f"mean error <= {real_pairs.MOST_MEAN_ERROR_PERCENT:g} %, {low:g} to {high:g} % in the interval"
    header = (
        "method",
        "camera",
        "measured",
        "mean error",
        "median",
        "worst",
        "bias",
        "in the 90 % interval",
        targets,
    )
    return Table("Real photographs", header, tuple(rows))


def set_table(summaries: Iterable[tuple[str, Setting, Mapping[str, Any]]]) -> Table:
    rows = [
        (
            name,
            setting.method,
            camera_words(setting),
            f"{s['found']} of {s['items']}",
            str(s["spurious"]),
            f"{s['count_correct']} of {s['scenes']}",
            f"{s['mean_iou']:.2f}",
            *(f"{s[f'{key}_percent']:.1f} %" for key in ("mape", "median")),
            f"{s['worst_percent']:.0f} %",
            f"{s['bias_percent']:+.1f} %",
            f"{s['interval_coverage_percent']:.0f} %",
        )
        for name, setting, s in summaries
    ]
    header = (
        "scenes",
        "method",
        "camera",
        "found",
        "spurious",
        "right count",
        "mean IoU",
        "mean error",
        "median",
    )
    return Table("Sets of scenes", (*header, "worst", "bias", "in the 90 % interval"), tuple(rows))


def fruit_table(scored: Sequence[Scored]) -> Table:
    """The founding paper's fruit: its own errors from its millilitres, and those of each setting here."""
    settings = list(dict.fromkeys(each.setting for each in scored))
    rows = []
    for fruit, (true_ml, paper_ml) in TABLE_I.items():
        ours = [
            ", ".join(
                percent(row["error"])
                for each in scored
                if each.setting == setting
                for row in each.rows
                if row["food"] == fruit
            )
            for setting in settings
        ]
        rows.append(
            (fruit, f"{true_ml:g}", f"{paper_ml:g} ({percent(paper_ml / true_ml - 1)})", *ours)
        )
    means = [
        mean_error([row["error"] for e in scored if e.setting == setting for row in e.rows])
        for setting in settings
    ]
    paper_mean = mean_error([paper_ml / true_ml - 1 for true_ml, paper_ml in TABLE_I.values()])
    rows.append(("mean error", "", paper_mean, *means))
    names = [f"{setting.method}, {camera_words(setting)}" for setting in settings]
    return Table(
        "The founding paper's fruit (its Table I)",
        ("fruit", "true, ml", "the paper, ml", *names),
        tuple(rows),
    )


def pooled_table(pooled: Mapping[Setting, Mapping[str, Any]]) -> Table:
    header = (
        "method",
        "camera",
        "foods",
        "mean error",
        "in the 90 % interval",
        "half width",
        "interval skill",
    )
    rows = [
        (
            setting.method,
            camera_words(setting),
            str(s["items"]),
            f"{s['mape_percent']:.1f} %",
            f"{s['interval_coverage_percent']:.0f} %",
            "-"
            if s["interval_half_width_percent"] is None
            else f"{s['interval_half_width_percent']:.1f} %",
            *(
                "-" if s[key] is None else f"{s[key]:.3f}"
                for key in ("interval_skill", "log_slope")
            ),
            f"{s['bias_percent']:+.1f} %",
        )
        for setting, s in pooled.items()
    ]
    return Table("All sets pooled", (*header, "log slope", "bias"), tuple(rows))


def bar_table(judged: Sequence[tuple[str, str, Setting, Mapping[str, Any]]]) -> Table:
    """Each target against each set of its kind that was measured in its way."""
    rows = []
    for target in TARGETS:
        for name, kind, setting, summary in judged:
            if (kind, setting) == (
                target.kind,
                Setting(JUDGED_METHOD, target.camera, target.hints, target.vessels),
            ):
                value = summary[target.figure]
                shown = (
                    "-"
                    if value is None
                    else f"{value:g}"
                    if isinstance(value, int)
                    else f"{value:.3g}"
                )
                figure = target.figure.replace("_percent", ", %").replace("_", " ")
                rows.append(
                    (
                        name,
                        camera_words(setting),
                        figure,
                        limits(target),
                        shown,
                        verdict(target, summary),
                    )
                )
    return Table(
        "Targets of the default method",
        ("scenes", "camera", "figure", "must be", "is", ""),
        tuple(rows),
    )


def verdict(target: Target, summary: Mapping[str, Any]) -> str:
    """Met, missed, or open where there are too few items to tell."""
    value = summary[target.figure]
    if value is None or summary["items"] < target.least_items:
        return f"open: {summary['items']} foods only"
    return "met" if target.least <= value <= target.most else "MISSED"


def limits(target: Target) -> str:
    if target.least == float("-inf"):
        return f"<= {target.most:g}"
    return (
        f">= {target.least:g}"
        if target.most == float("inf")
        else f"{target.least:g} to {target.most:g}"
    )


def percent(error: float | None) -> str:
    return "not found" if error is None else f"{100 * error:+.1f} %"


def mean_error(errors: Sequence[float | None]) -> str:
    """Mean of the sizes, a food that was not found as 100 %."""
    return (
        f"{100 * sum(1.0 if error is None else abs(error) for error in errors) / len(errors):.1f} %"
        if errors
        else ""
    )


def camera_words(setting: Setting) -> str:
    camera = "EXIF" if setting.camera == "exif" else setting.camera
    hints = "" if setting.hints == "none" else f", {setting.hints} hints"
    return camera + hints + (", vessel library" if setting.vessels else "")


def as_markdown(table: Table) -> str:
    lines = [table.header, ("---",) * len(table.header), *table.rows]
    body = "\n".join(
        "| " + " | ".join(cells) + " |" if cells[0] != "---" else "|" + "---|" * len(cells)
        for cells in lines
    )
    return f"## {table.title}\n\n{body}"


def as_text(table: Table) -> str:
    widths = [
        max(len(row[column]) for row in (table.header, *table.rows))
        for column in range(len(table.header))
    ]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (table.header, *table.rows)
    ]
    return "\n".join([table.title, *lines])


def heading(options: argparse.Namespace) -> str:
    """The day, the commit and what of the sets was left out."""
    day = datetime.now(tz=UTC).date().isoformat()
    part = "" if options.limit is None else f", the first {options.limit} scenes of each set only"
    return f"Measured on {day} at commit {commit()}, hints: {options.hints}{part}."


def commit() -> str:
    """The short id of the checkout's commit, and whether the program differs from it."""
    short = git("rev-parse", "--short", "HEAD")
    return (short or "unknown") + (
        " with changes" if git("status", "--porcelain", "--", "app") else ""
    )


def git(*arguments: str) -> str:
    """What git answers; nothing where there is no git or no repository."""
    program = shutil.which("git")
    if program is None:
        return ""
    return subprocess.run(
        [program, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()


def raw_rows(scored: Scored) -> Iterable[dict[str, Any]]:
    """The scorer's rows with their set, their setting and how many spurious items their scene has."""
    for row in scored.rows:
        yield {
            "set": scored.scene_set.name,
            **vars(scored.setting),
            **row,
            "spurious": scored.scene["spurious"],
        }


if __name__ == "__main__":
    raise SystemExit(main())
