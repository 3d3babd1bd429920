"""The counters, gauges and histograms of one process, in a separate registry.

Names: tada_*, seconds and bytes.

Each process is a separate target. Every label has few values, all defined by the program: codes,
routes' patterns, stages, states. Counters are updated where things happen; figures of the database
are read at the scrape (operations/figures.py).
"""

import platform
import re
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import product
from typing import Literal

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.metrics_core import Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.process_collector import ProcessCollector

from app import __version__
from app.metrics.shared_metrics import process_ids, shared_folder

REGISTRY = CollectorRegistry(auto_describe=True)
ProcessCollector(registry=REGISTRY)

REQUEST_BUCKETS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
STAGE_BUCKETS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
JOB_BUCKETS = (0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 60.0, 120.0, 300.0)
DAY_SECONDS = 86400.0
WAIT_BUCKETS = (
    1.0,
    3.0,
    10.0,
    30.0,
    60.0,
    120.0,
    300.0,
    600.0,
    1800.0,
    3600.0,
    21600.0,
    DAY_SECONDS,
)

BUILD = Gauge(
    "tada_build",
    "Always 1; which program this is.",
    ["version", "python", "part"],
    multiprocess_mode="max",
    registry=REGISTRY,
)

# outcomes of a job caused by the server and not by the photographs: the meal could have been
# measured
SERVER_FAILURES = (
    "internal_error",
    "job_gave_up",
    "estimate_crashed",
    "estimate_timed_out",
    "estimate_killed",
    "estimate_out_of_memory",
    "photo_damaged",
    "photograph_missing",
)
CHILD_OUTCOMES = ("ok", "crashed", "timed_out", "stalled", "killed", "out_of_memory", "raised")
MADE_OUTCOMES = ("done", "again", "lost", "died", "storage_full", "internal_error")
# refusals of an upload caused by the server and not by the phone
REFUSALS = ("storage_full", "unavailable", "internal_error", "server_busy")

# HTTP
REQUESTS = Histogram(
    "tada_http_request_seconds",
    "Requests: from their first byte to the answer's last, the caller's network included. status: 2xx, 4xx ...",
    ["method", "route", "status"],
    buckets=REQUEST_BUCKETS,
    registry=REGISTRY,
)
ANSWERS = Histogram(
    "tada_http_answer_seconds",
    "What the server itself takes: from the request's last byte to the answer's first. Not of calls that wait.",
    ["method", "route"],
    buckets=REQUEST_BUCKETS,
    registry=REGISTRY,
)
IN_FLIGHT = Gauge(
    "tada_http_requests_in_flight",
    "Requests under way, those that wait included.",
    multiprocess_mode="livesum",
    registry=REGISTRY,
)
RECEIVED = Counter("tada_http_received_bytes", "Bytes of requests' bodies.", registry=REGISTRY)
PROBLEMS = Counter(
    "tada_http_problems",
    "Requests refused or failed, by the code of the answer.",
    ["code"],
    registry=REGISTRY,
)
SIGN_INS = Counter(
    "tada_sign_ins",
    "Passwords that were tried: signing in, changing one's own. outcome: ok, failed, limited.",
    ["outcome"],
    registry=REGISTRY,
)
UPLOADS = Counter(
    "tada_uploads",
    "Requests that bring a meal or a photograph. outcome: kept, repeated (was there), cut (caller left), or a code.",
    ["outcome"],
    registry=REGISTRY,
)

# estimates
ESTIMATES = Counter(
    "tada_estimates",
    "Jobs that ended, counted once their end is committed. outcome: ok, or the failure's code.",
    ["purpose", "outcome"],
    registry=REGISTRY,
)
STAGES = Histogram(
    "tada_estimate_stage_seconds",
    "Steps of the pipeline.",
    ["stage"],
    buckets=STAGE_BUCKETS,
    registry=REGISTRY,
)
ESTIMATE_SECONDS = Histogram(
    "tada_estimate_seconds",
    "Estimates in the child process, whole.",
    buckets=JOB_BUCKETS,
    registry=REGISTRY,
)
JOB_WAIT = Histogram(
    "tada_job_wait_seconds",
    "From a job's queueing to its first start.",
    buckets=WAIT_BUCKETS,
    registry=REGISTRY,
)
JOBS_RUNNING = Gauge(
    "tada_jobs_running",
    "Jobs that this worker has in hand.",
    multiprocess_mode="livesum",
    registry=REGISTRY,
)
JOB_STEPS_FAILED = Counter(
    "tada_job_steps_failed",
    "Tries of a job's step that raised. passing: yes, a part is out of order for a while; no, it looks like a bug.",
    ["step", "passing"],
    registry=REGISTRY,
)
CHILDREN_STARTED = Counter(
    "tada_children_started", "Child processes that were started.", registry=REGISTRY
)
CHILD_RESULTS = Counter(
    "tada_child_results",
    "Requests to child processes, by how they ended. After all but ok the child is replaced.",
    ["outcome"],
    registry=REGISTRY,
)

# a worker's life
TAKEOVERS = Counter(
    "tada_takeovers", "Dead workers whose jobs this worker put back.", registry=REGISTRY
)
LOST_JOBS = Counter(
    "tada_lost_jobs", "Jobs claimed and never begun, queued again.", registry=REGISTRY
)
SWEPT = Counter(
    "tada_swept",
    "Meals that nothing would have moved, found by the sweep. what: queued (again) or failed.",
    ["what"],
    registry=REGISTRY,
)
HEARTBEAT = Gauge(
    "tada_worker_heartbeat_timestamp_seconds",
    "This worker's last heartbeat.",
    multiprocess_mode="max",
    registry=REGISTRY,
)
HEARTBEATS_FAILED = Counter(
    "tada_worker_heartbeats_failed", "Heartbeats that failed.", registry=REGISTRY
)
CHORES_FAILED = Counter(
    "tada_chores_failed", "Chores that ended with an error.", ["chore"], registry=REGISTRY
)
CHORE_DONE = Gauge(
    "tada_chore_done_timestamp_seconds",
    "When a chore last ended without an error.",
    ["chore"],
    multiprocess_mode="max",
    registry=REGISTRY,
)
DELIVERIES = Counter(
    "tada_webhook_deliveries",
    "Tries to deliver. outcome: delivered, failed, given_up.",
    ["outcome"],
    registry=REGISTRY,
)
BLOBS_DELETED = Counter(
    "tada_blobs_deleted",
    "Blobs deleted. why: erased, or orphan (no row named it).",
    ["why"],
    registry=REGISTRY,
)
PHOTOGRAPHS_ERASED = Counter(
    "tada_photographs_erased",
    "Photographs erased because they were older than their study keeps them.",
    registry=REGISTRY,
)
FILES_MADE = Counter(
    "tada_files_made",
    "Tries to make a file in the background. outcome: done, again, lost (called off or taken over), died, or a code.",
    ["kind", "outcome"],
    registry=REGISTRY,
)
CLOCK_DOUBTED = Gauge(
    "tada_clock_doubted",
    "1: the clock is a day or more off what was last seen; until it is trusted nothing is erased for its age.",
    multiprocess_mode="max",
    registry=REGISTRY,
)


def collect() -> Iterator[Metric]:
    """Yield this process's metrics; of a server with several, their sums, and process_* of each by its `pid`."""
    if shared_folder() is None:
        yield from REGISTRY.collect()
        return
    yield from MultiProcessCollector(None).collect()  # type: ignore[no-untyped-call]  # the library has no types here
    families: dict[str, Metric] = {}
    for pid in process_ids():
        for family in ProcessCollector(pid=partial(str, pid), registry=None).collect():
            together = families.setdefault(
                family.name, Metric(family.name, family.documentation, family.type)
            )
            for sample in family.samples:
                together.add_sample(sample.name, {"pid": pid}, sample.value)
    yield from families.values()


def outcome_label(code: str) -> str:
    """Return a code as a label; a text from a child process that is not a code becomes "other"."""
    return code if re.fullmatch(r"[a-z_]{1,64}", code) else "other"


def register_build(part: Literal["api", "worker"]) -> None:
    """Label this process, and start its counters at 0, since alerts do not see a series that starts at 1."""
    BUILD.labels(__version__, platform.python_version(), part).set(1)
    counters: list[tuple[Counter, Iterable[tuple[str, ...]]]]
    if part == "api":
        counters = [
            (UPLOADS, product(("kept", "repeated", "cut", *REFUSALS))),
            (SIGN_INS, product(("ok", "failed", "limited"))),
        ]
    else:
        counters = [
            (ESTIMATES, product(("meal", "after", "remeasure"), ("ok", *SERVER_FAILURES))),
            (CHILD_RESULTS, product(CHILD_OUTCOMES)),
            (DELIVERIES, product(("delivered", "failed", "given_up"))),
            (SWEPT, product(("queued", "failed"))),
            (BLOBS_DELETED, product(("erased", "orphan"))),
            (FILES_MADE, product(("export", "release"), MADE_OUTCOMES)),
        ]
    for counter, label_sets in counters:
        for labels in label_sets:
            counter.labels(*labels)
