"""A worker as a process: `run_jobs(settings, make_estimate, tasks=...)` works until a signal comes.

On SIGTERM and SIGINT it claims no more, gives running jobs a few seconds to end, then kills the children and hands the
rest back, all within ten seconds. If others have taken its lease (it was stopped, or the machine slept), it exits at
once with status LEASE_LOST, so that its supervisor starts it again under a new name.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import structlog

from app.children.child_pool import ChildPool, ChildPoolClosedError, ChildStartError
from app.children.cores import worker_concurrency
from app.core.settings import Settings
from app.db.session import Database, open_database
from app.jobs.chores import Chore, ChoreThread
from app.jobs.claims import Backlog, no_backlog
from app.jobs.supervisor import LEASE_LOST
from app.jobs.times import WorkerTimes
from app.meals.estimate.estimate_meal import EstimateMeal
from app.meals.estimate.job_worker import JobWorker

log = structlog.get_logger()

CHORES_SECONDS = 5.0  # for what chores do at the end
END_SECONDS = 10.0  # the process exits so long after a signal, even if something hangs


def run_jobs(
    settings: Settings,
    make_estimate: Callable[[Database, ChildPool], EstimateMeal],
    *,
    tasks: str,
    make_chores: Callable[[Database], Sequence[Chore]] = lambda _: (),
    make_backlog: Callable[[Database], Backlog] = lambda _: no_backlog,
    at_start: Callable[[], AbstractContextManager[None]] = nullcontext,
    times: WorkerTimes | None = None,
    protocol: int | None = None,
) -> int:
    """Work until a signal comes. Returns the exit status; must be called in the main thread.

    make_backlog: background jobs for idle cores (claims.py). tasks: the children's registry (child.py). at_start: a
    context around the start. times, protocol: set by tests.
    """
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with at_start():
        database = open_database(settings)
        concurrency = worker_concurrency(settings)
        pool = ChildPool(settings, tasks, children=concurrency)
        estimate = make_estimate(database, pool)
        worker = JobWorker(
            database,
            estimate,
            concurrency=concurrency,
            times=times,
            protocol=protocol,
            backlog=make_backlog(database),
        )
        pool.on_begin = worker.claims.note_computing
        pool.on_done = worker.claims.note_computed
        worker.start()
        chores = ChoreThread(make_chores(database))
        chores.start()
    threading.Thread(target=_warm_up, args=(pool,), daemon=True).start()
    while not stop.wait(0.2):
        if worker.lost.is_set():
            pool.close()
            _end_now(LEASE_LOST)  # there is nothing to hand back: others have taken its jobs
    watchdog = threading.Timer(END_SECONDS, _end_now, args=(0,))
    watchdog.daemon = True
    watchdog.start()
    chores.stop(0.0)  # a chore in progress may end while jobs do
    worker.drain()
    pool.close()
    is_idle = worker.stop()
    chores.stop(CHORES_SECONDS)  # last: they began to end with the signal, and jobs matter more
    if not is_idle:
        _end_now(0)
    database.dispose()
    watchdog.cancel()
    return 0


def _warm_up(pool: ChildPool) -> None:
    """Start the children, so that the first meal does not wait for imports."""
    try:
        pool.warm_up()
    except (ChildPoolClosedError, ChildStartError) as error:
        log.warning("child_not_warm", reason=str(error))


def _end_now(status: int) -> None:
    """Exit without waiting for threads that hang."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
