"""A worker whose children compute each pair of photographs once between them and recall its answer (remeasure.py).

Answers are kept in the folder `answers` below TMPDIR. The children's registry is
`benchmarks.recalling_worker:TASKS`, the process `python -m benchmarks.recalling_worker`.
"""

import contextlib
import hashlib
import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import app.tables  # noqa: F401  # defines every table
from app.children.child_pool import ChildPool, StageListener
from app.core.logs import configure_logging
from app.core.settings import Settings
from app.db.session import Database
from app.estimates.estimate_meal import EstimateMeal
from app.estimates.run_estimate import estimate_task
from app.jobs.queue import JobQueue
from app.jobs.worker_process import run_jobs
from app.remeasurements.feed_workers import FeedWorkers
from app.storage.opening import open_blob_store

ANSWER = "recalled-answer.json"  # beside the pictures of its steps


def recall_estimate(arguments: Mapping[str, Any], on_stage: StageListener) -> Mapping[str, Any]:
    """Return the answer for the same photographs and options; the first child that is asked computes it."""
    digest = hashlib.sha256(json.dumps(arguments["options"], sort_keys=True).encode())
    for photograph in arguments["photographs"].values():
        digest.update(Path(photograph).read_bytes())
    output, kept = Path(arguments["output_dir"]), Path(tempfile.gettempdir(), "answers", digest.hexdigest())
    if not kept.is_dir():
        answer = estimate_task(dict(arguments), on_stage)
        part = Path(tempfile.mkdtemp(dir=tempfile.gettempdir()))
        for path in output.iterdir():
            if not path.name.startswith("photo-"):
                shutil.copy(path, part)
        (part / ANSWER).write_text(json.dumps(answer))
        kept.parent.mkdir(exist_ok=True)
        with contextlib.suppress(OSError):  # another child was quicker
            part.rename(kept)
    for path in kept.iterdir():
        if path.name != ANSWER:
            shutil.copy(path, output)
    recalled: dict[str, Any] = json.loads((kept / ANSWER).read_text())
    return recalled


TASKS = {"estimate": recall_estimate}


def main() -> int:
    settings = Settings()
    configure_logging(settings)
    blobs = open_blob_store(settings.resolved_blob_url, settings)

    def make_use_cases(database: Database, pool: ChildPool) -> EstimateMeal:
        return EstimateMeal(database, blobs, pool, settings)

    def make_backlog(database: Database) -> FeedWorkers:
        return FeedWorkers(database, JobQueue())

    tasks = "benchmarks.recalling_worker:TASKS"
    return run_jobs(settings, make_use_cases, tasks=tasks, make_backlog=make_backlog)


if __name__ == "__main__":
    raise SystemExit(main())
