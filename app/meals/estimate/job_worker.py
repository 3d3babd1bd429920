"""The life of one worker: lease, heartbeats, claimed jobs, takeover from dead workers, sweeps, and an orderly end.

Heartbeats must never wait for anything else, so takeovers and sweeps have their own thread.
`run_jobs` is the worker as a process: it works until a signal comes. On SIGTERM and SIGINT it
claims no more, gives running jobs a few seconds to end, then kills the children and hands the rest
back, all within ten seconds. If others have taken its lease (it was stopped, or the machine slept),
it exits at once with status LEASE_LOST, so that its supervisor starts it again under a new name.
"""

import os
import signal
import sys
import threading
import uuid
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import structlog

from app.children.child_pool import ChildPool, ChildPoolClosedError, ChildStartError
from app.children.cores import worker_concurrency
from app.core.settings import Settings
from app.db.session import Database, open_database
from app.jobs import queries as jobs
from app.jobs.chores import Chore, ChoreThread
from app.jobs.claims import Backlog, Claims, no_backlog
from app.jobs.leases import open_lease
from app.jobs.queries import WorkerTimes
from app.jobs.queue import JOB_PROTOCOL_VERSION, JobQueue, sweep
from app.jobs.supervisor import LEASE_LOST
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.estimate.job_runner import JobRunner
from app.metrics import instruments

log = structlog.get_logger()

LOOKS_BEFORE_LOST = 5  # a claimed job that is not running at so many looks in a row was lost between claim and start
LOOKS_PER_SWEEP = 5
LEFT_SECONDS = 2.0  # for threads to notice that their child was killed


class JobWorker:
    """Runs one worker: start, then drain and stop.

    `lost` is set once others have taken its lease.
    """

    def __init__(
        self,
        database: Database,
        estimate: EstimatePair,
        *,
        concurrency: int,
        times: WorkerTimes | None = None,
        protocol: int | None = None,
        backlog: Backlog = no_backlog,
    ) -> None:
        self._database = database
        self._times = times or WorkerTimes()
        self._lease = open_lease(database, self._times)
        self._runner = JobRunner(database, self._lease, estimate, self._times)
        self.claims = Claims(
            database,
            self._lease,
            self._runner.run,
            concurrency=concurrency,
            protocol=JOB_PROTOCOL_VERSION if protocol is None else protocol,
            backlog=backlog,
            abandon=estimate.abandon,
        )
        self._queue = JobQueue(protocol=protocol)
        self._estimate = estimate
        self._ending = threading.Event()
        self._claimed_but_idle: Counter[uuid.UUID] = Counter()
        self._threads: list[threading.Thread] = []
        self.lost = threading.Event()

    @property
    def executor_id(self) -> str:
        """Unique for each start of a worker."""
        return self._lease.executor_id

    def start(self) -> None:
        """Acquire the lease, then start to claim jobs."""
        self._lease.acquire()
        self._start_thread(self._beat, "heartbeat")
        self.claims.start()
        self._start_thread(self._watch_others, "takeover")
        log.info("worker_started", executor_id=self.executor_id)

    def drain(self) -> bool:
        """Stop claiming, give running jobs a while to end, then make them stop.

        Returns False if some still run.
        """
        self.claims.stop()
        is_idle = self._runner.wait_until_idle(self._times.drain)
        self._runner.leave()
        return is_idle

    def stop(self) -> bool:
        """End at once and hand running jobs back.

        Returns False if a thread does not stop its job.
        """
        self._runner.leave()
        is_idle = self._runner.wait_until_idle(LEFT_SECONDS)
        self._ending.set()
        self._hand_back()
        for thread in self._threads:
            thread.join(LEFT_SECONDS)
        self._lease.release()
        log.info("worker_stopped", executor_id=self.executor_id, is_idle=is_idle)
        return is_idle

    def _hand_back(self) -> None:
        """Release the claims of jobs that are not running, so that others can begin them at once."""
        try:
            with self._database.write() as session:
                idle = jobs.claimed_jobs(session, self.executor_id) - self._runner.running
                jobs.release_claims(session, self.executor_id, idle, is_takeover=False)
        # the worker's edge: others take the jobs over once the lease is gone
        except Exception as error:
            log.warning("hand_back_failed", exc_info=error)

    def _start_thread(self, work: Callable[[], None], name: str) -> None:
        thread = threading.Thread(target=work, name=name, daemon=True)
        thread.start()
        self._threads.append(thread)

    def _beat(self) -> None:
        while not self._ending.wait(self._times.heartbeat):
            try:
                is_held = self._lease.renew()
            except Exception as error:  # the worker's edge: it waits until the database is back
                log.warning("heartbeat_failed", exc_info=error)
                instruments.HEARTBEATS_FAILED.inc()
                continue
            instruments.HEARTBEAT.set_to_current_time()
            if not is_held and not self._ending.is_set():
                log.error("lease_lost", executor_id=self.executor_id)
                self._runner.leave()
                self.lost.set()
                return

    def _watch_others(self) -> None:
        looks = 0
        while True:
            try:
                self._take_over()
                self._find_lost()
                self._abandon_unwanted()
                if looks % LOOKS_PER_SWEEP == 0:
                    sweep(self._database, self._queue, self._estimate.settle)
            except Exception as error:  # the worker's edge: it looks again later
                log.warning("takeover_failed", exc_info=error)
            looks += 1
            if self._ending.wait(self._times.heartbeat) or self.lost.is_set():
                return

    def _take_over(self) -> None:
        """Take over jobs of dead workers.

        It keeps no state: a restart of the database may lose a takeover.
        """
        with self._database.read() as session:
            holders = jobs.executors_with_claims(session) - {self.executor_id}
        dead = self._lease.bury(holders)
        if not dead:
            return
        log.warning("jobs_taken_over", dead_executors=sorted(dead))
        instruments.TAKEOVERS.inc(len(dead))
        for executor_id in sorted(dead):
            with self._database.write() as session:
                jobs.release_claims(session, executor_id, is_takeover=True)

    def _abandon_unwanted(self) -> None:
        """End estimates whose meals were cancelled or erased."""
        running = self._runner.running
        if not running:
            return
        with self._database.read() as session:
            unwanted = jobs.unwanted_jobs(session, running)
        for job_id in unwanted:
            self._estimate.abandon(job_id)

    def _find_lost(self) -> None:
        """Release claimed jobs that are not running: the claim's answer was lost, or the run broke off."""
        with self._database.read() as session:
            idle = jobs.claimed_jobs(session, self.executor_id) - self._runner.running
        self._claimed_but_idle = Counter(
            {job_id: self._claimed_but_idle[job_id] + 1 for job_id in idle}
        )
        lost = [
            job_id for job_id, looks in self._claimed_but_idle.items() if looks >= LOOKS_BEFORE_LOST
        ]
        if not lost or self._ending.is_set():
            return
        with self._database.write() as session:
            released = jobs.release_claims(session, self.executor_id, lost, is_takeover=True)
        log.warning("lost_jobs_queued_again", job_ids=[str(job_id) for job_id in lost])
        instruments.LOST_JOBS.inc(released)


CHORES_SECONDS = 5.0  # for what chores do at the end
END_SECONDS = 10.0  # the process exits so long after a signal, even if something hangs


def run_jobs(
    settings: Settings,
    make_estimate: Callable[[Database, ChildPool], EstimatePair],
    *,
    tasks: str,
    make_chores: Callable[[Database, ChildPool], Sequence[Chore]] = lambda *_: (),
    make_backlog: Callable[[Database], Backlog] = lambda _: no_backlog,
    at_start: Callable[[], AbstractContextManager[None]] = nullcontext,
    times: WorkerTimes | None = None,
    protocol: int | None = None,
) -> int:
    """Work until a signal comes. Returns the exit status; must be called in the main thread.

    make_backlog: background jobs for idle cores (claims.py)
    tasks: the children's registry (child.py)
    at_start: a context around the start
    times, protocol: set by tests
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
        chores = ChoreThread(make_chores(database, pool))
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
