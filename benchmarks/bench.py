"""The short form of the benchmarks: one table of figures against those of the last release (`make bench`).

    python -m benchmarks.bench [--only NAME]... [--release VERSION] [--data FOLDER]

Writes docs/performance.md. benchmarks/figures.json holds the figures of the last release and of the last run; a figure
that was not measured now stays as it was. --release makes the figures of now those of the release. FOLDER (default:
TADA_SHARED_DATA) holds accuracy/floor.py and scenes/dev/; without it the rows of pairs are left as they were.

A figure is a ratio to a yardstick of the same run where there is one, else processor time: the machine's speed changes
from minute to minute. Less is better, but for uploads' throughput.
"""

import argparse
import json
import os
import random
import resource
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2

from app.children.api_children import ApiChildren
from app.core.process_life import collect_rarely
from app.core.settings import Settings
from app.db.session import Database
from app.exports.export_file import request_of
from app.exports.export_spec import ExportSpec
from app.exports.file_task import FileTasks
from app.exports.lists.list_records import list_records
from app.http.file_formats import Output
from app.http.row_filter import RowFilter
from app.people.access.caller import StaffCaller
from benchmarks import api, pipeline, precheck
from benchmarks.query import PAGE, Who, callers, draw, filled_database, filter_sets, quantile
from benchmarks.query_exports import bare_loop

ROOT = Path(__file__).resolve().parents[1]
FIGURES, DOCUMENT = ROOT / "benchmarks" / "figures.json", ROOT / "docs" / "performance.md"
RECORDS = 50_000
LAST_DAY = "9000-01-01"
SCENES = 3  # of paper6 and of meals
SAMPLES = 4  # of each set of filters

Values = dict[str, float]


@dataclass(frozen=True)
class Figure:
    """A row. name: with its yardstick or unit."""

    name: str
    more_is_better: bool = False


ROWS: Mapping[str, Figure] = {
    "pipeline": Figure(
        "a pair's estimate, one thread: time to that of plain OpenCV calls (floor.py)"
    ),
    "pipeline_mb": Figure("a pair's estimate: peak memory, MB"),
    "check": Figure("pre-check of a pair: time to that of decoding it"),
    "check_no_board": Figure("pre-check of a pair without a board: time to that of decoding it"),
    "check_other_board": Figure(
        "pre-check of a pair, another board announced: time to that of decoding it"
    ),
    "upload_disk": Figure(
        "uploads of 8 MB, 8 at once: throughput to write + fsync", more_is_better=True
    ),
    "upload_bare": Figure(
        "uploads of 8 MB, 8 at once: throughput to a bare endpoint", more_is_better=True
    ),
    "upload_ms": Figure("upload of 8 MB: the server's processor time, ms"),
    "upload_children_ms": Figure(
        "upload of 8 MB: processor time of the children that decode it, ms"
    ),
    "poll_ms": Figure("GET of a waiting meal: the server's processor time, ms"),
    "csv": Figure("records as CSV: processor time to that of the driver's bare loop"),
    "parquet": Figure("records as Parquet: processor time to that of the driver's bare loop"),
    "page_owner_ms": Figure(
        "page of 100 records, owner, any filters: p95 of the processor time, ms"
    ),
    "page_admin_ms": Figure(
        "page of 100 records, admin, any filters: p95 of the processor time, ms"
    ),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--only", action="append", choices=sorted(PARTS), help="Measure this part; may be repeated."
    )
    parser.add_argument(
        "--release", metavar="VERSION", help="Keep what is measured now as this release's figures."
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("TADA_SHARED_DATA", ROOT.parent / "shared")),
    )
    arguments = parser.parse_args()
    kept = (
        json.loads(FIGURES.read_text())
        if FIGURES.exists()
        else {"version": "", "release": {}, "now": {}}
    )
    measured: Values = {}
    for name in arguments.only or PARTS:
        started = time.perf_counter()
        measured |= PARTS[name](arguments.data)
        print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    kept["now"] |= measured
    if arguments.release:
        kept |= {"version": arguments.release, "release": measured}
    FIGURES.write_text(json.dumps(kept, indent=2) + "\n")
    text = table(kept["now"], kept["release"], kept["version"])
    DOCUMENT.write_text(text)
    print(f"\n{text}\nload average: {os.getloadavg()[1]:.1f} on {os.cpu_count()} processors")
    return 0


def table(now: Values, release: Values, version: str) -> str:
    """docs/performance.md."""
    kept = version or "none is kept yet"
    lines = [
        "# Performance\n",
        "Written by `make bench`: short forms of the benchmarks, ten minutes. `benchmarks/figures.json` keeps the",
        f"figures of now and those of the last release ({kept}), with which they are compared. A figure has its",
        "yardstick in the same run where it names one; else it is processor time, so that machines and loads compare",
        "roughly. The long forms and their tables are in [capacity.md](capacity.md).\n",
        "| what | now | last release | ratio | better |",
        "|---|---|---|---|---|",
    ]
    for name, row in ROWS.items():
        value, then = now.get(name), release.get(name)
        ratio = f"{value / then:.2f}" if value is not None and then else "-"
        better = "more" if row.more_is_better else "less"
        lines.append(f"| {row.name} | {_cell(value)} | {_cell(then)} | {ratio} | {better} |")
    return "\n".join(lines) + "\n"


def _cell(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.3g}"


def measure_pipeline(data: Path) -> Values:
    """Time and memory of the first pairs of two sets."""
    floor = data / "accuracy" / "floor.py"
    scenes = [
        scene for name in ("paper6", "meals") for scene in pipeline.find_scenes(data, name)[:SCENES]
    ]
    if not scenes or not floor.is_file():
        return {}
    options = argparse.Namespace(method=None, calibrated=False)
    ratio, peak_mb = pipeline.print_times(scenes, options, floor)
    return {"pipeline": ratio, "pipeline_mb": peak_mb}


def measure_checks(data: Path) -> Values:
    """Times of checks of the first pairs of a set."""
    scenes = pipeline.find_scenes(data, "meals")[:SCENES]
    if not scenes:
        return {}
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as name:
        children = ApiChildren(Settings(data_dir=Path(name)))
        try:
            with_board, without, other = precheck.print_times(children, scenes, 2, Path(name))
        finally:
            children.close()
    return {"check": with_board, "check_no_board": without, "check_other_board": other}


def measure_uploads(_: Path) -> Values:
    """On SQLite and files, of a server of its own."""
    arguments = argparse.Namespace(rounds=3, meals=24, concurrency=[8])
    with (
        tempfile.TemporaryDirectory(prefix="tada-bench-") as name,
        api.deployment("sqlite", Path(name)) as server,
    ):
        tokens = api.enrol(server, 8)
        server.rest_mb = server.memory_mb("VmRSS")
        large, small = server.folder / "large.jpg", server.folder / "small.jpg"
        large.write_bytes(api.photograph(api.PHOTO_BYTES))
        small.write_bytes(api.photograph(60_000))
        server.order("upload", photo=str(small), tokens=tokens, concurrency=8, times=64)  # warm
        (uploaded,) = api.uploads(server, arguments, tokens, [[str(large), str(large)]])
        (poll_ms,) = api.polls(server, arguments, tokens, small)
    return {
        "upload_disk": uploaded.ratio,
        "upload_bare": uploaded.bare_ratio,
        "upload_ms": uploaded.server_ms,
        "upload_children_ms": uploaded.children_ms,
        "poll_ms": poll_ms,
    }


def measure_records(_: Path) -> Values:
    """Files and pages of records on SQLite, in this process: all of their work is this thread's."""
    with filled_database("sqlite", RECORDS, 1, None, keep=False) as (url, _folder):
        database = Database(url)
        admin, owner, _phone = callers(database)
        bare = min(processor_time(lambda: bare_loop(url, LAST_DAY)) for _ in range(3))
        collect_rarely()  # as servers do
        values = {
            output: min(
                processor_time(lambda output=output: export(database, output)) for _ in range(2)
            )
            / bare
            for output in ("csv", "parquet")
        }
        chance = random.Random(1)
        for who in (owner, admin):
            values[f"page_{who.name}_ms"] = quantile(page_times(database, who, chance), 0.95) * 1000
        database.dispose()
    return values


def page_times(database: Database, who: Who, chance: random.Random) -> list[float]:
    """Processor time of first pages of all filters and pairs of them, seconds."""
    return [
        processor_time(
            lambda chosen=chosen: list_records(
                database, who.caller, chosen, cursor=None, limit=PAGE
            )
        )
        for names in filter_sets()
        for chosen in (draw(names, chance) for _ in range(SAMPLES))
    ]


def export(database: Database, output: Output) -> None:
    """All records as a file, whose bytes are dropped."""
    caller = StaffCaller(uuid.uuid4(), "benchmark", is_admin=True, token_id=uuid.uuid4())
    spec = ExportSpec("items", "wide", output, "headline", RowFilter(), provenance=True)
    with tempfile.TemporaryDirectory() as folder:
        request = request_of(database, caller, spec, Path(folder) / "rows")
        FileTasks(database, Path(folder), 0).run("export", request, most_seconds=600.0)


def processor_time(work: Callable[[], object]) -> float:
    """Return the processor time of this thread and of processes that ended, seconds."""

    def seconds() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.thread_time() + children.ru_utime + children.ru_stime

    started = seconds()
    work()
    return seconds() - started


PARTS: Mapping[str, Callable[[Path], Values]] = {
    "pipeline": measure_pipeline,
    "checks": measure_checks,
    "uploads": measure_uploads,
    "records": measure_records,
}


if __name__ == "__main__":
    sys.exit(main())
