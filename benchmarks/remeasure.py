"""Measure a study's meals again by the same pipeline: figures that differ, pairs lost or doubled, phones that wait.

    python benchmarks/remeasure.py [--meals 200] [--workers 2] [--database sqlite] [--visitors 5] [--recall]

A real server takes the bundled rendered pairs in turn over HTTP, with the foods that they show; real worker processes
of one estimate each measure them. People then confirm and correct some. The study is measured again; meanwhile one
worker is killed (SIGKILL) and replaced, the remeasurement is stopped and continued over HTTP, and some phones send a
new meal each. Printed: figures of the records that differ afterwards (all columns but `change_seq` and the run), pairs
that have no new run (lost) or several saved ones (doubled), and how long the new meals waited for a worker, beside the
same number of meals sent to idle workers before. --recall: each pair is computed once, and its answer recalled for
every other meal, which takes a tenth of the time: it shows what is lost, doubled or saved otherwise, but not that the
pipeline repeats itself.
"""

import argparse
import contextlib
import itertools
import json
import statistics
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import sqlalchemy as sa

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from app.cli.demo import (  # noqa: E402
    PLATES,
    Plate,
    checked,
)
from app.jobs.leases import living_workers  # noqa: E402
from app.meals.stored.job_models import Job, RemeasuredPair  # noqa: E402
from app.meals.stored.models import Meal  # noqa: E402
from app.meals.stored.record_models import Run  # noqa: E402
from benchmarks.processes import end  # noqa: E402
from benchmarks.workers import Place, deployment, environment, wait_until_alive, wait_until_made  # noqa: E402

PATH = "/v1/studies/workers/remeasurements"
STILL_SECONDS = 10  # a stopped remeasurement is watched for so long
UNCOMPARED = frozenset({"change_seq", "run_id"})
LOOK_SECONDS = 0.5


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--meals", type=int, default=200)
    parser.add_argument(
        "--workers", type=int, default=2, help="processes, each of one estimate at a time"
    )
    parser.add_argument("--database", default="sqlite", choices=["sqlite", "postgresql"])
    parser.add_argument("--visitors", type=int, default=5, help="meals that phones send meanwhile")
    parser.add_argument("--recall", action="store_true", help="compute each pair only once")
    options = parser.parse_args(arguments)
    with deployment(options.database) as place, contextlib.ExitStack() as processes:
        workers = [start_worker(place, processes, options) for _ in range(options.workers)]
        wait_until_alive(place.database, options.workers)
        wait_until_made(place, send(place, options.workers, "warm"))
        began = time.monotonic()
        meals = send(place, options.meals, "bench")
        wait_until_made(place, meals)
        print(f"{options.meals} meals measured in {time.monotonic() - began:.0f} s", flush=True)
        idle = [waits_of(place, visit(place)) for _ in range(options.visitors)]
        say(place, meals)
        return remeasure(place, options, workers, processes, idle)


def remeasure(
    place: Place,
    options: argparse.Namespace,
    workers: list[subprocess.Popen[bytes]],
    processes: contextlib.ExitStack,
    idle: Sequence[float],
) -> int:
    before = records_of(place)
    began = time.monotonic()
    started = checked(place.admin.post(PATH, json={})).json()
    visits = [
        visit_when(place, started["id"], (number + 1) / (3 * options.visitors + 3))
        for number in range(options.visitors)
    ]
    wait_for_share(place, started["id"], 0.4)
    workers[0].kill()
    workers[0] = start_worker(place, processes, options)
    wait_for_share(place, started["id"], 0.6)
    stopped = checked(place.admin.post(f"{PATH}/{started['id']}/stop")).json()
    time.sleep(STILL_SECONDS)
    still = checked(place.admin.get(f"{PATH}/{started['id']}")).json()
    checked(place.admin.post(f"{PATH}/{started['id']}/continue"))
    ended = wait_for_share(place, started["id"], None)
    seconds = time.monotonic() - began - STILL_SECONDS
    after = records_of(place)
    differing = [
        (key, name)
        for key, row in before.items()
        for name in row
        if row[name] != after.get(key, {}).get(name)
    ]
    missing, doubled = pairs_of(place, started["id"])
    busy = [waits_of(place, meal) for meal in visits]
    print(f"remeasured {ended['pairs']} pairs in {seconds:.0f} s: {json.dumps(ended)}")
    print(f"stopped at {stopped['measured']} measured, {STILL_SECONDS} s later {still['measured']}")
    print(
        f"records {len(before)}, figures compared {sum(map(len, before.values()))}, differing {len(differing)}"
    )
    print(f"pairs without a new run {missing}, pairs with more than one saved run {doubled}")
    print(
        f"a phone's meal waited for a worker: idle {summary(idle)}; while measuring again {summary(busy)}"
    )
    is_good = not (differing or missing or doubled) and stopped["measured"] == still["measured"]
    return 0 if is_good else 1


def start_worker(
    place: Place, processes: contextlib.ExitStack, options: argparse.Namespace
) -> subprocess.Popen[bytes]:
    command = ["tests.e2e.recalling", "worker"] if options.recall else ["app.cli", "worker"]
    variables = environment(place.settings) | {"TMPDIR": str(place.settings.data_dir)}
    worker = subprocess.Popen([sys.executable, "-m", *command], env=variables, cwd=ROOT)
    processes.callback(end, worker)
    return worker


def send(place: Place, count: int, name: str) -> list[uuid.UUID]:
    """Upload the bundled pairs in turn, with the foods that they show, as so many meals: their ids."""
    return [
        send_plate(place, plate, f"{name} {number}")
        for number, plate in zip(range(count), itertools.cycle(PLATES.values()))
    ]


def send_plate(place: Place, plate: Plate, name: str) -> uuid.UUID:
    folder = ROOT / "app" / "demo_data" / plate.folder
    photos = {
        side: (f"{side}.jpg", (folder / f"{side}.jpg").read_bytes(), "image/jpeg")
        for side in ("left", "right")
    }
    metadata = {
        "id": str(uuid.uuid5(uuid.NAMESPACE_OID, name)),
        "captured_at": "2026-11-20T12:30:00+00:00",
        "time_zone": "UTC",
        "hints": [{"point": point, "food": food} for food, point in plate.points.items()],
    }
    parts = {
        "metadata": ("metadata.json", json.dumps(metadata).encode(), "application/json")
    } | photos
    checked(place.client.post("/v1/meals", files=parts))
    return uuid.UUID(metadata["id"])


def visit(place: Place) -> uuid.UUID:
    """Send one meal and wait until it is measured: its id."""
    meal = send_plate(place, PLATES["apple"], str(uuid.uuid4()))
    wait_until_made(place, [meal])
    return meal


def visit_when(place: Place, remeasurement: str, share: float) -> uuid.UUID:
    wait_for_share(place, remeasurement, share)
    return visit(place)


def say(place: Place, meals: Sequence[uuid.UUID]) -> None:
    """Every third meal is confirmed, of every fourth the first item gets grams, of every fifth a share."""
    for number, meal in enumerate(meals):
        path = f"/v1/meals/{meal}"
        items = checked(place.client.get(path)).json()["items"]
        events: list[dict[str, Any]] = []
        if items and number % 4 == 0:
            events.append({"kind": "set_mass", "item": items[0]["id"], "mass_g": 100.0 + number})
        if items and number % 5 == 0:
            events.append({"kind": "set_share", "item": items[0]["id"], "share": 0.5})
        if number % 3 == 0:
            events.append({"kind": "confirm_meal"})
        for event in events:
            checked(
                place.client.post(
                    f"{path}/events",
                    json={"id": str(uuid.uuid4())} | event,
                    headers={"If-Match": "*"},
                )
            )


def records_of(place: Place) -> dict[str, dict[str, Any]]:
    """Item -> its record as the API gives it, of all meals."""
    return {row["id"]: row for row in _records(place)}


def _records(place: Place) -> Iterator[dict[str, Any]]:
    path: str | None = "/v1/records?limit=1000"
    while path is not None:
        page = checked(place.admin.get(path)).json()
        yield from (
            {name: row[name] for name in row if name not in UNCOMPARED} for row in page["items"]
        )
        path = page["next"]


def wait_for_share(place: Place, remeasurement: str, share: float | None) -> dict[str, Any]:
    """Wait until so much of the remeasurement is done; None: all of it. Returns its numbers."""
    while True:
        numbers: dict[str, Any] = checked(place.admin.get(f"{PATH}/{remeasurement}")).json()
        done = numbers["pairs"] - numbers["waiting"]
        if numbers["state"] == "done" or (share is not None and done >= share * numbers["pairs"]):
            return numbers
        if not living_workers(place.database):
            raise SystemExit("no worker is alive")
        time.sleep(LOOK_SECONDS)


def pairs_of(place: Place, remeasurement: str) -> tuple[int, int]:
    """Return the numbers of pairs without a new run, and with more than one that was saved."""
    own_id = uuid.UUID(remeasurement)
    with place.database.read() as session:
        pairs = session.scalars(
            sa.select(RemeasuredPair).where(RemeasuredPair.remeasurement_id == own_id)
        ).all()
        runs = session.execute(
            sa.select(Run.meal_id, Run.id).where(Run.remeasurement_id == own_id)
        ).all()
    by_meal = {
        meal_id: [run_id for other, run_id in runs if other == meal_id] for meal_id, _ in runs
    }
    missing = sum(
        pair.job_id not in by_meal.get(pair.meal_id, ())
        for pair in pairs
        if pair.state != "skipped"
    )
    return missing, sum(len(run_ids) > 1 for run_ids in by_meal.values())


def waits_of(place: Place, meal: uuid.UUID) -> float:
    """Seconds from the queue to the start of a meal's own estimate."""
    with place.database.read() as session:
        query = (
            sa.select(Job)
            .join(Meal, Meal.id == Job.meal_id)
            .where(Meal.client_id == meal, Job.purpose == "meal")
        )
        job = session.scalars(query).one()
    if job.started_at is None:
        raise ValueError(f"the meal {meal} was not begun")
    return (job.started_at - job.enqueued_at).total_seconds()


def summary(seconds: Sequence[float]) -> str:
    return (
        f"median {statistics.median(seconds):.2f} s, most {max(seconds):.2f} s" if seconds else "-"
    )


if __name__ == "__main__":
    raise SystemExit(main())
