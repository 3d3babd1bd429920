"""The worker's composition root: `tada worker`, or `python -m app.worker` beside `tada serve` as its child."""

import argparse
import os
import sys
from functools import partial

import structlog

import app.tables  # noqa: F401  # defines every table
from app.children.child_pool import ChildPool
from app.core.errors import TadaError
from app.core.logs import configure_logging
from app.core.process_life import die_with_parent, keep_files_private
from app.core.settings import Settings
from app.db.session import Database, open_database
from app.extras.reminders.send_reminders import reminder_chores
from app.extras.sandbox.injection import may_identify
from app.identification.food_index import open_index
from app.jobs.chores import Chore
from app.jobs.queue import JobQueue
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.estimate.job_worker import run_jobs
from app.metrics.instruments import REGISTRY, register_build
from app.metrics.server import MetricsServer
from app.operations.chores import worker_chores
from app.operations.explain_errors import check_stores, explained_errors
from app.operations.prepare import prepare_patiently
from app.people.access.secret_box import open_secret_box
from app.records.rebuild_index import DescribeIdly
from app.records.remeasurements.remeasurements import FeedWorkers
from app.storage.opening import open_blob_store

log = structlog.get_logger()

TASKS = "app.meals.estimate.child_tasks:TASKS"
NOT_STARTED = 2  # exit status, as of a command that did not do what it was told
# it keeps all cores busy while meals wait; the server on them still answers first
NICENESS_BESIDE_SERVER = 5
DESCRIBE_SECONDS = 2.0  # from meal to meal, when vectors are made anew


def run_worker(settings: Settings) -> int:
    """Work until SIGTERM or SIGINT. Returns the exit status. Raises TadaError, in words, where it cannot begin.

    What ends it later keeps its traceback.
    """
    configure_logging(settings)
    with explained_errors():
        check_stores(settings)
        box = open_secret_box(settings)
        database = open_database(settings)
        try:
            prepare_patiently(database, settings)
        finally:
            database.dispose()
        blobs = open_blob_store(settings.resolved_blob_url, settings)

    metrics = _serve_metrics(settings)

    def make_estimate(database: Database, pool: ChildPool) -> EstimatePair:
        index = partial(open_index, settings.food_index)
        return EstimatePair(database, blobs, pool, settings, index, may_identify)

    def make_chores(database: Database, pool: ChildPool) -> list[Chore]:
        describe = DescribeIdly(database, blobs, pool, settings)
        return [
            *reminder_chores(database, box, settings),
            *worker_chores(database, blobs, box, settings),
            Chore("describe_regions", DESCRIBE_SECONDS, describe.run),
        ]

    def make_backlog(database: Database) -> FeedWorkers:
        return FeedWorkers(database, JobQueue())

    try:
        return run_jobs(
            settings,
            make_estimate,
            tasks=TASKS,
            make_chores=make_chores,
            make_backlog=make_backlog,
            at_start=explained_errors,
        )
    finally:
        if metrics is not None:
            metrics.stop()


def _serve_metrics(settings: Settings) -> MetricsServer | None:
    """On the worker's own port, if it has one. A worker works without it: a port that is taken is told, no more."""
    register_build("worker")
    if settings.worker_metrics_port is None:
        return None
    token = (
        settings.metrics_token.get_secret_value() if settings.metrics_token is not None else None
    )
    try:
        server = MetricsServer(REGISTRY, settings.metrics_host, settings.worker_metrics_port, token)
    except OSError as error:
        log.error("metrics_not_served", port=settings.worker_metrics_port, reason=error.strerror)  # noqa: TRY400
        return None
    server.start()
    log.info("metrics_served", host=settings.metrics_host, port=server.port)
    return server


def main() -> None:
    """`python -m app.worker [--parent PID]`: with a parent, it dies with it."""
    keep_files_private()
    parser = argparse.ArgumentParser(description="A worker of tada-server.")
    parser.add_argument(
        "--parent", type=int, help="process id; the worker ends when that process does"
    )
    arguments = parser.parse_args()
    if arguments.parent is not None:
        die_with_parent(arguments.parent)
        os.nice(NICENESS_BESIDE_SERVER)
    try:
        status = run_worker(Settings())
    except TadaError as error:
        print(f"tada: {error.message}", file=sys.stderr)  # noqa: T201  # as the command does
        status = NOT_STARTED
    raise SystemExit(status)


if __name__ == "__main__":
    main()
