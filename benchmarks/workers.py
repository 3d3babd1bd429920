"""Meals a minute for 1, 2, ... workers, and the share of their time that is not the pipeline.

    python benchmarks/workers.py [--meals 24] [--workers 1 2] [--databases sqlite postgresql] [--pair FOLDER]

A real server takes the meals over HTTP, real worker processes of one estimate each make them. Each worker is warm
before the clock runs; the time is from the first claim to the last end in the database. Beside it stands the yardstick
of the same minute: as many bare processes that run the pipeline alone on the same pair, so that a machine
whose two cores share one memory is not counted against the workers. FOLDER holds left.jpg and right.jpg with a board of
9x7 squares of 11 mm; default: the bundled pair.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import httpx2
import sqlalchemy as sa

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.cli.demo import MARKER, checked, client_of, enrol  # noqa: E402
from app.core.settings import Settings  # noqa: E402
from app.db.session import Database  # noqa: E402
from app.jobs.leases import living_workers  # noqa: E402
from app.jobs.supervisor import settings_environment  # noqa: E402
from app.meals.stored.job_models import Job  # noqa: E402  # found from the checkout, installed or not
from app.meals.stored.models import Meal  # noqa: E402  # found from the checkout, installed or not
from app.meals.stored.record_models import Run  # noqa: E402  # found from the checkout, installed or not
from app.people.access.staff import create_admin  # noqa: E402
from benchmarks.databases import database_url  # noqa: E402
from benchmarks.processes import end  # noqa: E402

START_SECONDS = 120
MEAL_SECONDS = 120
WARM_UP = 3  # meals a worker before the clock runs, so that each had one
BARE = """
import sys, time
import cv2
cv2.setNumThreads(1)
from pathlib import Path
from app.meals.estimate.estimate_files import estimate_files, read_options
options = read_options(marker="plain:9x7:11", camera=None, method="shape", hints=[])
pair = [Path(sys.argv[1]) / f"{side}.jpg" for side in ("left", "right")]
def make(): return estimate_files(*pair, options, max_pixels=60_000_000, debug=None, on_stage=None)
make()
print("ready", flush=True)
sys.stdin.readline()
for _ in range(int(sys.argv[2])): make()
print("done", flush=True)
"""


@dataclass(frozen=True)
class Made:
    """seconds: from the first claim to the last end. pipeline: the stages' seconds of all meals."""

    meals: int
    workers: int
    seconds: float
    pipeline: float

    @property
    def outside(self) -> float:
        """The share of the workers' time that is not the pipeline."""
        return 1 - self.pipeline / (self.seconds * self.workers)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--meals", type=int, default=24, help="a run, shared by its workers")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument(
        "--databases", nargs="+", default=["sqlite", "postgresql"], choices=["sqlite", "postgresql"]
    )
    parser.add_argument("--pair", type=Path, default=ROOT / "app" / "demo_data")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args(arguments)
    print(
        "| database | workers | meals/min | x one worker | bare x one | pipeline s a meal | not the pipeline |"
    )
    print("|---|---|---|---|---|---|---|")
    for kind in options.databases:
        with deployment(kind) as place:
            rounds = [
                {
                    count: (
                        bare_pace(options.pair, count, options.meals),
                        run_workers(place, options, count),
                    )
                    for count in options.workers
                }
                for _ in range(options.repeat)
            ]
        print_rows(kind, options.workers, rounds)
    return 0


def print_rows(
    kind: str, workers: Sequence[int], rounds: Sequence[dict[int, tuple[float, Made]]]
) -> None:
    for count in workers:
        made = [found[count][1] for found in rounds]
        times = [
            one.meals / one.seconds / (found[workers[0]][1].meals / found[workers[0]][1].seconds)
            for one, found in zip(made, rounds, strict=True)
        ]
        bare = [found[count][0] / found[workers[0]][0] for found in rounds]
        print(
            f"| {kind} | {count} | {statistics.median(60 * one.meals / one.seconds for one in made):.1f}"
            f" | {statistics.median(times):.2f} | {statistics.median(bare):.2f}"
            f" | {statistics.median(one.pipeline / one.meals for one in made):.2f}"
            f" | {statistics.median(one.outside for one in made):.1%} |",
            flush=True,
        )


@dataclass(frozen=True)
class Place:
    """A server without a worker, and a phone that is enrolled in it (client)."""

    settings: Settings
    database: Database
    client: httpx2.Client
    admin: httpx2.Client


@contextlib.contextmanager
def deployment(kind: str) -> Iterator[Place]:
    """On an empty database of this kind, with a folder for the photographs."""
    with (
        tempfile.TemporaryDirectory(prefix="tada-bench-") as name,
        database_url(kind, Path(name)) as url,
    ):
        settings = Settings(
            data_dir=Path(name),
            database_url=url,
            blob_url=None,
            port=0,
            log_level="WARNING",
            secret_key="a key for benchmarks, of no worth",
            worker_concurrency=1,
        )
        process = subprocess.Popen(
            [sys.executable, "-m", "app.cli", "serve", "--no-worker"],
            env=environment(settings),
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        database = Database(settings.resolved_database_url)
        try:
            with client_of(address_of(process), create_admin(database, "benchmark")) as admin:
                checked(
                    admin.post(
                        "/v1/studies", json={"code": "workers", "name": "Workers", "marker": MARKER}
                    )
                )
                with enrol(admin, "workers", {"code": "P001"}) as phone:
                    yield Place(settings, database, phone, admin)
        finally:
            database.dispose()
            end(process)


def address_of(process: subprocess.Popen[str]) -> str:
    for line in process.stderr or ():
        if "listens on " in line:
            return line.rsplit(" ", 1)[1].strip()
        print(line, end="", file=sys.stderr)
    raise SystemExit("the server did not start")


def environment(settings: Settings) -> dict[str, str]:
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("TADA_")}
    return inherited | settings_environment(settings)


def run_workers(place: Place, options: argparse.Namespace, count: int) -> Made:
    """So many workers make the meals; each has made one before."""
    workers = []
    try:
        for _ in range(count):
            command = [sys.executable, "-m", "app.cli", "worker"]
            workers.append(subprocess.Popen(command, env=environment(place.settings), cwd=ROOT))
        wait_until_alive(place.database, count)
        wait_until_made(place, send(place, options.pair, WARM_UP * count))
        meals = send(place, options.pair, options.meals)
        wait_until_made(place, meals)
        with place.database.read() as session:
            jobs = session.execute(
                sa.select(Job.started_at, Job.finished_at, Job.executor_id, Run.seconds)
                .join(Run, Run.id == Job.id)
                .join(Meal, Meal.id == Job.meal_id)
                .where(Meal.client_id.in_(meals))
            ).all()
    finally:
        for worker in workers:
            end(worker)
    if len({job.executor_id for job in jobs}) != count:
        raise SystemExit(f"not all of the {count} workers had a meal: take more meals")
    begun, ended = min(job.started_at for job in jobs), max(job.finished_at for job in jobs)
    return Made(
        options.meals, count, (ended - begun).total_seconds(), sum(job.seconds for job in jobs)
    )


def wait_until_alive(database: Database, count: int) -> None:
    deadline = time.monotonic() + START_SECONDS
    while len(living_workers(database)) < count:
        if time.monotonic() > deadline:
            raise SystemExit("the workers did not start in time")
        time.sleep(0.2)


def send(place: Place, pair: Path, count: int) -> list[uuid.UUID]:
    """Upload the pair as so many meals: the ids."""
    photos = {
        side: (f"{side}.jpg", (pair / f"{side}.jpg").read_bytes(), "image/jpeg")
        for side in ("left", "right")
    }
    sent = []
    for _ in range(count):
        metadata = {
            "id": str(uuid.uuid4()),
            "captured_at": "2026-11-20T12:30:00+00:00",
            "time_zone": "UTC",
        }
        parts = {
            "metadata": ("metadata.json", json.dumps(metadata).encode(), "application/json")
        } | photos
        checked(place.client.post("/v1/meals", files=parts))
        sent.append(uuid.UUID(metadata["id"]))
    return sent


def wait_until_made(place: Place, meals: Sequence[uuid.UUID]) -> None:
    deadline = time.monotonic() + START_SECONDS + MEAL_SECONDS * len(meals)
    while time.monotonic() < deadline:
        with place.database.read() as session:
            query = (
                sa.select(Job.state)
                .join(Meal, Meal.id == Job.meal_id)
                .where(Meal.client_id.in_(meals))
            )
            states = session.scalars(query).all()
        if states.count("failed"):
            raise SystemExit("a meal failed: see the worker's log")
        if states.count("done") == len(meals):
            return
        time.sleep(0.5)
    raise SystemExit("the workers did not make the meals in time")


def bare_pace(pair: Path, processes: int, meals: int) -> float:
    """Meals a second of so many processes that do nothing but the pipeline."""
    each = max(1, meals // processes)
    running = [
        subprocess.Popen(
            [sys.executable, "-c", BARE, str(pair), str(each)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=os.environ | ONE_THREAD,
        )
        for _ in range(processes)
    ]
    for process in running:
        process.stdout.readline()  # type: ignore[union-attr]
    started = time.perf_counter()
    for process in running:
        process.stdin.write("go\n")  # type: ignore[union-attr]
        process.stdin.flush()  # type: ignore[union-attr]
    for process in running:
        process.stdout.readline()  # type: ignore[union-attr]
    seconds = time.perf_counter() - started
    for process in running:
        process.communicate()
    return each * processes / seconds


ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)

if __name__ == "__main__":
    raise SystemExit(main())
