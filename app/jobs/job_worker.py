"""The life of one worker: lease, heartbeats, claimed jobs, takeover from the dead, sweeps, and an orderly end.

Two threads beside DBOS's: heartbeats must never wait for anything else, so takeover and sweep have their own.
"""

import threading
import uuid
from collections import Counter
from collections.abc import Callable

import structlog

from app.db.queries import jobs
from app.db.session import Database
from app.jobs.engine import APPLICATION, Engine, JobQueue
from app.jobs.leases import open_lease
from app.jobs.sweep import sweep
from app.jobs.times import WorkerTimes
from app.jobs.workflows import EstimateUseCases, EstimateWorkflow
from app.metrics import instruments

log = structlog.get_logger()

LOOKS_BEFORE_LOST = (
    5  # a job claimed by us that does not run at so many looks in a row was lost between claim and start
)
LOOKS_A_SWEEP = 5
LEFT_SECONDS = 2.0  # for threads to notice that their child was killed


class JobWorker:
    """Makes one worker live: start, then drain and stop. `lost` is set when others were told that it is dead."""

    def __init__(
        self,
        database: Database,
        use_cases: EstimateUseCases,
        *,
        concurrency: int,
        times: WorkerTimes | None = None,
        protocol: int | None = None,
    ) -> None:
        self._database = database
        self._times = times or WorkerTimes()
        self._lease = open_lease(database, self._times)
        self._workflow = EstimateWorkflow(database, self._lease, use_cases, self._times)
        self._engine = Engine(database, self._lease.executor_id, concurrency=concurrency, protocol=protocol)
        self._queue = JobQueue(database, protocol=protocol)
        self._use_cases = use_cases
        self._ending = threading.Event()
        self._claimed_but_idle: Counter[str] = Counter()
        self._threads: list[threading.Thread] = []
        self.lost = threading.Event()

    @property
    def executor_id(self) -> str:
        """The name of this start of this worker."""
        return self._lease.executor_id

    def start(self) -> None:
        """Live, then claim jobs."""
        self._lease.acquire()
        self._begin(self._beat, "heartbeat")
        try:
            self._engine.launch(self._workflow.bind)
        except BaseException:
            self._ending.set()
            self._lease.release()
            raise
        self._begin(self._look_after_others, "takeover")
        log.info("worker_started", executor_id=self.executor_id)

    def note_computing(self, job_id: str) -> None:
        """The job needs a child, maybe again, if what it had found could not be sealed."""
        self._engine.note_computing(job_id)

    def note_computed(self, job_id: str) -> None:
        """The job needs no child any more: the next may be claimed while it is sealed and saved."""
        self._engine.note_computed(job_id)

    def drain(self) -> bool:
        """Claim nothing more and give running jobs a while to end; then let go of them. False: some still run."""
        self._engine.stop_claiming()
        is_idle = self._workflow.wait_until_idle(self._times.drain)
        self._workflow.leave()
        return is_idle

    def stop(self) -> bool:
        """End, and leave what still runs to others, at once. False: a thread does not let go of its job."""
        self._workflow.leave()
        is_idle = self._workflow.wait_until_idle(LEFT_SECONDS)
        self._ending.set()
        self._hand_back()
        for thread in self._threads:
            thread.join(LEFT_SECONDS)
        self._lease.release()
        self._engine.shut_down()
        self._queue.close()
        log.info("worker_stopped", executor_id=self.executor_id, is_idle=is_idle)
        return is_idle

    def _hand_back(self) -> None:
        """Put what was claimed and has been let go of back into the queue, for others to begin at once."""
        try:
            with self._database.read() as session:
                claimed = jobs.pending_workflows_of(session, self.executor_id)
            for job_id in sorted(claimed - self._workflow.running):
                with self._database.write() as session:
                    jobs.forgive_claim(session, job_id, self.executor_id)
                self._engine.requeue(job_id, self.executor_id)
        except Exception as error:  # the worker's edge: others take them over once the lease is gone
            log.warning("hand_back_failed", exc_info=error)

    def _begin(self, work: Callable[[], None], name: str) -> None:
        thread = threading.Thread(target=work, name=name, daemon=True)
        thread.start()
        self._threads.append(thread)

    def _beat(self) -> None:
        while not self._ending.wait(self._times.heartbeat):
            try:
                is_held = self._lease.renew()
            except Exception as error:  # the worker's edge: without a database it waits for one
                log.warning("heartbeat_failed", exc_info=error)
                instruments.HEARTBEATS_FAILED.inc()
                continue
            instruments.HEARTBEAT.set_to_current_time()
            if not is_held and not self._ending.is_set():
                log.error("lease_lost", executor_id=self.executor_id)
                self._workflow.leave()
                self.lost.set()
                return

    def _look_after_others(self) -> None:
        looks = 0
        while True:
            try:
                self._take_over()
                self._find_lost()
                self._abandon_unwanted()
                if looks % LOOKS_A_SWEEP == 0:
                    sweep(self._database, self._queue, self._use_cases.settle)
            except Exception as error:  # the worker's edge: the next look comes
                log.warning("takeover_failed", exc_info=error)
            looks += 1
            if self._ending.wait(self._times.heartbeat) or self.lost.is_set():
                return

    def _take_over(self) -> None:
        """Everything anew at each look: one call of recovery may be lost with the database's restart."""
        with self._database.read() as session:
            pending = jobs.executors_with_pending_work(session, APPLICATION) - {self.executor_id}
        dead = self._lease.bury(pending)
        if dead:
            log.warning("jobs_taken_over", dead_executors=sorted(dead))
            instruments.TAKEOVERS.inc(len(dead))
            self._requeue_jobs_of(dead)

    def _abandon_unwanted(self) -> None:
        """Spare the rest of estimates whose meals were cancelled or erased."""
        running = self._workflow.running
        if not running:
            return
        with self._database.read() as session:
            unwanted = jobs.unwanted_jobs(session, running)
        for job_id in unwanted:
            self._use_cases.abandon(uuid.UUID(job_id))

    def _requeue_jobs_of(self, dead: set[str]) -> None:
        for executor_id in sorted(dead):
            with self._database.read() as session:
                claimed = jobs.pending_workflows_of(session, executor_id)
            for job_id in sorted(claimed):
                self._engine.requeue(job_id, executor_id)

    def _find_lost(self) -> None:
        with self._database.read() as session:
            claimed = jobs.pending_workflows_of(session, self.executor_id)
        idle = claimed - self._workflow.running
        self._claimed_but_idle = Counter({job: self._claimed_but_idle[job] + 1 for job in idle})
        for job, looks in self._claimed_but_idle.items():
            if looks >= LOOKS_BEFORE_LOST and not self._ending.is_set() and self._engine.requeue(job, self.executor_id):
                log.warning("lost_job_queued_again", job_id=job)
                instruments.LOST_JOBS.inc()
