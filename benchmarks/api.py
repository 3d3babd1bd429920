"""How fast meals are taken and told about, over HTTP from a real `tada serve`, beside a yardstick of the same run.

    python -m benchmarks.api [--only sqlite|postgresql] [--rounds 3] [--meals 64] [--concurrency 1 8 32]
                             [--flow-seconds 30] [--folder FOLDER] [--no-polls] [--processes 1]
                             [--pairs FOLDER]

On SQLite with files, and on PostgreSQL with an S3 server (SeaweedFS), each fresh and of our own. No worker: meals wait
in the queue, which is what stands in the pipeline's place. The load comes from another process
(benchmarks/api_load.py).

- Uploads: pairs of 2 x 4 MB, closed loop. Yardstick: the same bytes written and fsynced to the same disk by as many
  threads, two files a meal; with S3: put to the same server. On files also benchmarks/bare_endpoint.py:
  what FastAPI and uvicorn alone cost on the same bytes. Rounds of all take turns; ratios are of the medians, the range
  of the ratios of neighbours. Processor: milliseconds a meal of the server, of the children that decode the
  photographs, and of the bare endpoint. Peak: the server's resident memory at its highest (VmHWM, cleared before),
  and by how much that is more than it had at rest.
- With --pairs, such as ../shared/scenes/dev/meals: only uploads of the stereo pairs there, and the bare endpoint also
  decodes each photograph once, in as many processes as the server has children.
- Polls: GET /v1/meals/{id} by phones of their own, closed loop.
- Flow: 50 meals a second of small pairs, open loop: each is sent when it is due, its latency counted from then.
  Afterwards every meal that was sent is looked for: its row, its job, its photographs' hashes as they lie in the store.

Limits of calls are switched off. CPU: seconds of a processor per second of wall, of the server and of the load, which
share this machine with the yardstick's disk or S3 server.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import httpx2
import numpy as np
import sqlalchemy as sa
from PIL import Image

from app.core.settings import Settings
from app.db.session import Database
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.storage.opening import open_blob_store
from benchmarks.api_load import Outcome, percentiles
from benchmarks.databases import database_url
from benchmarks.processes import children_of, end, processor_seconds
from tests.support.s3_server import S3Server

ROOT = Path(__file__).resolve().parents[1]
MEGABYTE = 1_000_000
PHOTO_BYTES = 4 * MEGABYTE
LEAST_RATIO, LEAST_BARE_RATIO, MOST_PEAK_MB = 0.5, 0.8, 150.0
POLLS = 2000
FLOW_PER_SECOND = 50
FLOW_PHONES = 64
LIMITS_OFF = dict.fromkeys(
    (
        "TADA_DEVICE_UPLOADS_PER_MINUTE",
        "TADA_DEVICE_CALLS_PER_MINUTE",
        "TADA_STAFF_CALLS_PER_MINUTE",
        "TADA_ADDRESS_UPLOADS_PER_MINUTE",
        "TADA_ADDRESS_CALLS_PER_MINUTE",
    ),
    "0",
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", choices=("sqlite", "postgresql"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--meals", type=int, default=64, help="Of 8 MB, in each round.")
    parser.add_argument("--concurrency", type=int, nargs="+", default=[1, 8, 32])
    parser.add_argument("--flow-seconds", type=float, default=30.0)
    parser.add_argument("--no-polls", action="store_true")
    parser.add_argument(
        "--processes", type=int, default=1, help="Of the server; figures of memory are their sums."
    )
    parser.add_argument(
        "--pairs", type=Path, help="Folder with stereo pairs, */left.jpg and */right.jpg."
    )
    parser.add_argument(
        "--folder", type=Path, help="On the disk that is measured; default: the system's for such."
    )
    arguments = parser.parse_args()
    needed = 4 * 2 * PHOTO_BYTES * arguments.meals + 4_000 * MEGABYTE
    is_fine = True
    for kind in [arguments.only] if arguments.only else ["sqlite", "postgresql"]:
        with tempfile.TemporaryDirectory(prefix="tada-api-", dir=arguments.folder) as name:
            free = shutil.disk_usage(name).free
            if free < needed:
                print(
                    f"{free / MEGABYTE:.0f} MB are free in {name}; this needs {needed / MEGABYTE:.0f}"
                )
                return 1
            with deployment(
                kind, Path(name), arguments.processes, decodes=arguments.pairs is not None
            ) as server:
                is_fine &= measure(server, arguments)
    return 0 if is_fine else 1


@dataclass
class Deployment:
    """A server that runs, and what the load needs to know of it. stored: orders of the yardstick."""

    name: str
    folder: Path
    environment: dict[str, str]
    process: subprocess.Popen[bytes]
    port: int
    yardstick: dict[str, Any]
    bare: tuple[subprocess.Popen[bytes], int] | None = None  # the bare endpoint and its port
    rest_mb: float = 0.0
    processes: int = 1

    @property
    def pids(self) -> list[int]:
        """The processes that answer, without those that decode photographs."""
        return children_of(self.process.pid) if self.processes > 1 else [self.process.pid]

    @property
    def bare_port(self) -> int:
        """Of the bare endpoint."""
        if self.bare is None:
            raise SystemExit("There is no bare endpoint beside S3.")
        return self.bare[1]

    @property
    def settings(self) -> Settings:
        """As the server has them."""
        ours = {key: value for key, value in self.environment.items() if key.startswith("TADA_")}
        fields = {key.removeprefix("TADA_").lower(): value for key, value in ours.items()}
        return Settings(**fields)  # type: ignore[arg-type]  # text, as from the environment

    def order(self, do: str, **more: Any) -> Outcome:
        """Have the load done by its own process."""
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.api_load"],
            input=json.dumps({"port": self.port, **more, "do": do}).encode(),
            stdout=subprocess.PIPE,
            cwd=ROOT,
            check=True,
        )
        return Outcome(**json.loads(done.stdout))

    def cpu_seconds(self) -> float:
        """Processor time of the server so far, without its children."""
        return processor_seconds(self.pids)

    def child_seconds(self) -> float:
        """Processor time of the server's living children so far."""
        return processor_seconds([child for pid in self.pids for child in children_of(pid)])

    def clear_peak(self) -> None:
        """Let the peak of memory begin anew."""
        for pid in self.pids:
            Path(f"/proc/{pid}/clear_refs").write_text("5")

    def memory_mb(self, which: str) -> float:
        """Resident memory in 10^6 bytes. which: VmRSS, as it is; VmHWM, at its highest since `clear_peak`."""
        kib = 0
        for pid in self.pids:
            status = Path(f"/proc/{pid}/status").read_text()
            kib += int(
                next(
                    line.split()[1] for line in status.splitlines() if line.startswith(f"{which}:")
                )
            )
        return kib * 1024 / MEGABYTE


@contextlib.contextmanager
def deployment(
    kind: str, folder: Path, processes: int = 1, *, decodes: bool = False, **variables: str
) -> Iterator[Deployment]:
    """A fresh server; all that was started for it ends with it. decodes: the bare endpoint does so too."""
    with contextlib.ExitStack() as stack:
        environment = {
            key: value for key, value in os.environ.items() if not key.startswith("TADA_")
        }
        environment |= LIMITS_OFF | {
            "TADA_DATA_DIR": str(folder / "data"),
            "TADA_DATABASE_URL": stack.enter_context(database_url(kind, folder)),
            "TADA_SECRET_KEY": "k" * 40,
            "TADA_ENROLMENT_ATTEMPTS_PER_MINUTE": "100000",
            "TADA_PORT": "0",
            **variables,
        }
        (folder / "yardstick").mkdir()
        yardstick: dict[str, Any] = {"do": "disk", "folder": str(folder / "yardstick")}
        name = "SQLite + files"
        if kind == "postgresql":
            s3 = S3Server.start(folder / "s3")
            stack.callback(s3.stop)
            s3.make_bucket("tada")
            keys = {"access_key_id": s3.access_key_id, "secret_access_key": s3.secret_access_key}
            environment |= {"TADA_BLOB_URL": "s3://tada/bench", "TADA_S3_ENDPOINT": s3.endpoint}
            environment |= {f"TADA_S3_{key.upper()}": value for key, value in keys.items()}
            yardstick = {"do": "bucket", "url": "s3://tada", "endpoint": s3.endpoint, **keys}
            name = "PostgreSQL + S3"
        log = stack.enter_context((folder / "server.log").open("wb"))
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "app.cli",
                "serve",
                "--no-worker",
                "--processes",
                str(processes),
            ],
            env=environment,
            stdout=log,
            stderr=log,
            cwd=ROOT,
        )
        stack.callback(end, process)
        bare = None
        if kind == "sqlite":
            (folder / "bare").mkdir()
            bare_log = stack.enter_context((folder / "bare.log").open("wb"))
            command = [sys.executable, "-m", "benchmarks.bare_endpoint", str(folder / "bare")]
            command += [str(Settings.model_fields["api_children"].default)] if decodes else []
            bare_process = subprocess.Popen(command, stdout=bare_log, stderr=bare_log, cwd=ROOT)
            stack.callback(end, bare_process)
            bare = bare_process, _port(bare_process, folder / "bare.log")
        port = _port(process, folder / "server.log")
        yield Deployment(
            name, folder, environment, process, port, yardstick, bare, processes=processes
        )


def _port(process: subprocess.Popen[bytes], log: Path) -> int:
    words = "tada-server listens on http://127.0.0.1:"
    while process.poll() is None:
        for line in log.read_text().splitlines():
            if line.startswith(words):
                return int(line.removeprefix(words))
        time.sleep(0.1)
    raise SystemExit(f"the server ended:\n{log.read_text()}")


def measure(server: Deployment, arguments: argparse.Namespace) -> bool:
    """Print a server's tables; whether all targets hold."""
    tokens = enrol(server, max(FLOW_PHONES, *arguments.concurrency))
    server.rest_mb = server.memory_mb("VmRSS")
    large, small = server.folder / "large.jpg", server.folder / "small.jpg"
    large.write_bytes(photograph(PHOTO_BYTES))
    small.write_bytes(photograph(60_000))
    server.order("upload", photo=str(small), tokens=tokens, concurrency=8, times=64)  # warm
    if arguments.pairs is not None:
        pairs = pairs_in(arguments.pairs)
        server.order("upload", pairs=pairs, tokens=tokens, concurrency=8, times=16)  # warm
        server.order(
            "upload", pairs=pairs, tokens=tokens, concurrency=8, times=16, port=server.bare_port
        )
        return all(outcome.is_fine for outcome in uploads(server, arguments, tokens, pairs))
    is_fine = all(
        outcome.is_fine
        for outcome in uploads(server, arguments, tokens, [[str(large), str(large)]])
    )
    if not arguments.no_polls:
        polls(server, arguments, tokens, small)
    return flow(server, arguments, tokens, small) and is_fine


@dataclass(frozen=True)
class UploadFigures:
    """At one concurrency. ratios: throughput to write and fsync, and to the bare endpoint's (NaN: there is none)."""

    ratio: float
    bare_ratio: float
    peak_mb: float
    server_ms: float
    children_ms: float

    @property
    def is_fine(self) -> bool:
        """Return whether the targets hold."""
        return (
            self.ratio >= LEAST_RATIO or self.bare_ratio >= LEAST_BARE_RATIO
        ) and self.peak_mb <= MOST_PEAK_MB


def pairs_in(folder: Path) -> list[list[str]]:
    """The left and the right photograph of each pair in a folder."""
    return [
        [str(left), str(left.with_name("right.jpg"))] for left in sorted(folder.glob("*/left.jpg"))
    ]


def uploads(
    server: Deployment, arguments: argparse.Namespace, tokens: list[str], pairs: list[list[str]]
) -> list[UploadFigures]:
    sizes = [Path(path).stat().st_size for pair in pairs for path in pair]
    meal_mb = 2 * sum(sizes) / len(sizes) / MEGABYTE
    print(
        f"\n### {server.name}: pairs of {meal_mb:.1f} MB, {arguments.rounds} rounds of {arguments.meals} meals\n"
    )
    columns = (
        "at once|MB/s|yardstick MB/s|ratio|of neighbours|bare endpoint MB/s|ratio to it|p50 ms|p95 ms|p99 ms|peak MB"
        "|over rest MB|server, ms a meal|children|bare endpoint|load's CPU"
    )
    print_head(columns)
    figures, volume = list[UploadFigures](), meal_mb * arguments.meals
    per_meal_ms = 1000 / arguments.meals
    for concurrency in arguments.concurrency:
        common = {
            "photo": pairs[0][0],
            "pairs": pairs,
            "concurrency": concurrency,
            "times": arguments.meals,
        }
        ours, plain, latencies, cpu, load_cpu = [], [], [], [], []
        bare, bare_cpu, child_cpu = [], [], []
        server.clear_peak()
        for _ in range(arguments.rounds):
            outcome = server.order(**server.yardstick, **common)
            fail_on(outcome)
            plain.append(volume / outcome.seconds)
            _empty(server.folder / "yardstick")
            if server.bare is not None:
                process, port = server.bare
                bare_pids = [process.pid, *children_of(process.pid)]
                before = processor_seconds(bare_pids)
                outcome = server.order("upload", tokens=tokens, **common, port=port)
                fail_on(outcome)
                bare.append(volume / outcome.seconds)
                bare_cpu.append((processor_seconds(bare_pids) - before) * per_meal_ms)
                _empty(server.folder / "bare")
            before, before_child = server.cpu_seconds(), server.child_seconds()
            outcome = server.order("upload", tokens=tokens, **common)
            fail_on(outcome)
            ours.append(volume / outcome.seconds)
            latencies += outcome.latencies
            cpu.append((server.cpu_seconds() - before) * per_meal_ms)
            child_cpu.append((server.child_seconds() - before_child) * per_meal_ms)
            load_cpu.append(outcome.cpu_seconds / outcome.seconds)
        ratios = [mine / other for mine, other in zip(ours, plain, strict=True)]
        ratio, peak = median(ours) / median(plain), server.memory_mb("VmHWM")
        bare_ratio = median(ours) / median(bare) if bare else float("nan")
        figures.append(UploadFigures(ratio, bare_ratio, peak, median(cpu), median(child_cpu)))
        p50, p95, p99 = percentiles(latencies)
        print(
            f"| {concurrency} | {median(ours):.0f} | {median(plain):.0f} | {ratio:.2f} "
            f"| {min(ratios):.2f}-{max(ratios):.2f} | {median(bare) if bare else 0:.0f} | {bare_ratio:.2f} "
            f"| {p50:.0f} | {p95:.0f} | {p99:.0f} | {peak:.0f} | {peak - server.rest_mb:.0f} | {median(cpu):.1f} "
            f"| {median(child_cpu):.1f} | {median(bare_cpu) if bare else 0:.1f} | {median(load_cpu):.2f} |",
            flush=True,
        )
    return figures


def polls(
    server: Deployment, arguments: argparse.Namespace, tokens: list[str], photo: Path
) -> list[float]:
    """Print a row a concurrency; the server's processor time of a call in each, ms."""
    print(f"\n### {server.name}: status polls\n")
    print_head("at once|calls/s|p50 ms|p95 ms|p99 ms|CPU|load's CPU|server, ms a call")
    meals, own_ms = list[str](), list[float]()
    for token in tokens[: max(arguments.concurrency)]:
        outcome = server.order("upload", photo=str(photo), tokens=[token], concurrency=1, times=1)
        fail_on(outcome)
        meals += list(outcome.sent)
    for concurrency in arguments.concurrency:
        before = server.cpu_seconds()
        outcome = server.order(
            "poll", tokens=tokens, meals=meals, concurrency=concurrency, times=POLLS
        )
        fail_on(outcome)
        spent = server.cpu_seconds() - before
        own_ms.append(spent / POLLS * 1000)
        cpu = spent / outcome.seconds
        p50, p95, p99 = percentiles(outcome.latencies)
        print(
            f"| {concurrency} | {len(outcome.latencies) / outcome.seconds:.0f} | {p50:.1f} | {p95:.1f} | {p99:.1f} "
            f"| {cpu:.2f} | {outcome.cpu_seconds / outcome.seconds:.2f} | {own_ms[-1]:.1f} |",
            flush=True,
        )
    return own_ms


def flow(server: Deployment, arguments: argparse.Namespace, tokens: list[str], photo: Path) -> bool:
    times = int(FLOW_PER_SECOND * arguments.flow_seconds)
    server.clear_peak()
    before = server.cpu_seconds()
    outcome = server.order(
        "flow",
        photo=str(photo),
        tokens=tokens[:FLOW_PHONES],
        times=times,
        per_second=FLOW_PER_SECOND,
    )
    cpu, peak = (server.cpu_seconds() - before) / outcome.seconds, server.memory_mb("VmHWM")
    lost, wrong = look_for(server, outcome.sent)
    p50, p95, p99 = percentiles(outcome.latencies or [float("nan")])
    size_kb = photo.stat().st_size / 1000
    print(
        f"\n### {server.name}: {FLOW_PER_SECOND} meals/s of small pairs (2 x {size_kb:.0f} kB), open loop\n"
    )
    print_head(
        "sent|accepted|errors|lost|wrong hash|seconds|p50 ms|p95 ms|p99 ms|peak MB|CPU|load's CPU"
    )
    print(
        f"| {times} | {len(outcome.sent)} | {len(outcome.errors)} | {lost} | {wrong} | {outcome.seconds:.1f} "
        f"| {p50:.0f} "
        f"| {p95:.0f} | {p99:.0f} | {peak:.0f} | {cpu:.2f} | {outcome.cpu_seconds / outcome.seconds:.2f} |",
        flush=True,
    )
    for error in sorted(set(outcome.errors))[:5]:
        print(f"- {error}")
    return not (outcome.errors or lost or wrong)


def look_for(server: Deployment, sent: dict[str, list[str]]) -> tuple[int, int]:
    """How many meals that were acknowledged are not there whole, and how many photographs have other bytes."""
    settings = server.settings
    database, blobs = (
        Database(settings.resolved_database_url),
        open_blob_store(settings.resolved_blob_url, settings),
    )
    try:
        with database.read() as session:
            queued = set(
                session.scalars(sa.select(Meal.client_id).join(Job, Job.meal_id == Meal.id))
            )
            columns = (
                MealImage.slot,
                MealImage.received_sha256,
                MealImage.stored_sha256,
                MealImage.blob_key,
            )
            images = session.execute(
                sa.select(Meal.client_id, *columns).join(Meal, Meal.id == MealImage.meal_id)
            ).all()
    finally:
        database.dispose()
    here = {(str(row.client_id), row.slot): row for row in images}
    ids = {str(client_id) for client_id in queued}
    lost = sum(
        1
        for meal in sent
        if meal not in ids or not {(meal, "left"), (meal, "right")} <= here.keys()
    )

    def is_wrong(row: Any, sha256: str) -> bool:
        stored = hashlib.sha256(blobs.read(row.blob_key)).hexdigest()
        return row.received_sha256 != sha256 or stored != row.stored_sha256

    pairs = [
        (here[meal, slot], sha256)
        for meal, hashes in sent.items()
        for slot, sha256 in zip(("left", "right"), hashes, strict=True)
        if (meal, slot) in here
    ]
    with ThreadPoolExecutor(4) as pool:
        return lost, sum(pool.map(lambda pair: is_wrong(*pair), pairs))


def enrol(server: Deployment, count: int, study: str = "b") -> list[str]:
    """Tokens of so many phones, each of a participant of its own in a new study, by the command and the API."""
    admin = subprocess.run(
        [sys.executable, "-m", "app.cli", "admin", "create", f"bench-{study}"],
        env=server.environment | {"TADA_LOG_LEVEL": "WARNING"},
        stdout=subprocess.PIPE,
        cwd=ROOT,
        check=True,
    ).stdout.decode()
    tokens, headers = [], {"Authorization": f"Bearer {admin.strip()}"}
    with httpx2.Client(
        base_url=f"http://127.0.0.1:{server.port}", headers=headers, timeout=60
    ) as client:
        client.post(
            "/v1/studies", json={"code": study, "name": study, "marker": "plain:9x7:11"}
        ).raise_for_status()
        for number in range(count):
            code = f"P{number:03}"
            client.post(f"/v1/studies/{study}/participants", json={"code": code}).raise_for_status()
            issued = (
                client.post(f"/v1/studies/{study}/participants/{code}/enrolment-codes")
                .raise_for_status()
                .json()
            )
            device = {"code": issued["code"], "device_name": "bench"}
            tokens.append(
                client.post("/v1/enrolments", json=device).raise_for_status().json()["token"]
            )
    return tokens


def photograph(wanted_bytes: int) -> bytes:
    """A JPEG of noise of about so many bytes."""
    side = 256
    while True:
        pixels = np.random.default_rng(1).integers(0, 256, (side * 3 // 4, side, 3), np.uint8)
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, "JPEG", quality=75)
        if buffer.tell() >= 0.97 * wanted_bytes:
            return buffer.getvalue()
        side = max(side + 8, int(side * (wanted_bytes / buffer.tell()) ** 0.5) // 8 * 8)


def print_head(columns: str) -> None:
    names = columns.split("|")
    print(f"| {' | '.join(names)} |")
    print(f"|{'---|' * len(names)}")


def fail_on(outcome: Outcome) -> None:
    if outcome.errors:
        raise SystemExit(f"{len(outcome.errors)} errors, such as {outcome.errors[0]}")


def _empty(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


if __name__ == "__main__":
    sys.exit(main())
