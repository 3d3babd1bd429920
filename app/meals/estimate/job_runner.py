"""Run one job: compute the estimate, then save it in one transaction with the job's end.

An estimate may be computed twice, if a worker dies; it is saved once: during that transaction the
worker's lease is held, and the job is locked, unfinished and still claimed by this worker. The key
of the computed result is kept in the job's row, so that a worker which takes the job over only has
to save it.

A job whose files meet a passing fault is put off, so that others go on. A fault of the database is
waited out. A step that fails by a bug is retried a few times; then the meal fails, and the worker
goes on.
"""

import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import sqlalchemy.exc
import structlog
from sqlalchemy.orm import Session

from app.children.faults import INTERNAL_ERROR, BrokenOff, JobFailure, JobLeft, is_passing
from app.core.errors import Failure
from app.core.logs import bind_log_context, log_context
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.leases import Lease
from app.jobs.queries import WorkerTimes
from app.meals.estimate.estimate_pair import EstimatePair, SealedAnswer
from app.meals.stored.job_models import Job
from app.metrics import instruments

log = structlog.get_logger()

TRIES = 3  # of a step that fails by a bug, within one claim of the job
TRIES_ALONE = 2  # further tries of an estimate that was killed or took too long


@dataclass(frozen=True, slots=True)
class Computed:
    """The key of the sealed result, or the reason why there is none."""

    result_key: str | None
    failure: Failure | None = None


class JobRunner:
    """One per worker process."""

    def __init__(
        self, database: Database, lease: Lease, estimate: EstimatePair, times: WorkerTimes
    ) -> None:
        self._database = database
        self._lease = lease
        self._estimate = estimate
        self._times = times
        self._leaving = threading.Event()
        self._running: Counter[uuid.UUID] = Counter()
        self._lock = threading.Lock()

    @property
    def running(self) -> frozenset[uuid.UUID]:
        """Ids of the jobs that this process is running."""
        with self._lock:
            return frozenset(+self._running)

    def leave(self) -> None:
        """Make all jobs stop at the next opportunity, because the process ends."""
        self._leaving.set()

    def wait_until_idle(self, seconds: float) -> bool:
        """Return whether all jobs ended within that time."""
        deadline = time.monotonic() + seconds
        while self.running:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
        return True

    def run(self, job_id: uuid.UUID) -> None:
        """Run a claimed job to its end. Raises JobLeft if the worker leaves it to others."""
        with self._running_job(job_id) as facts:
            computed = self._compute(job_id)
            if computed is not None and self._persist(job_id, computed):
                self._log_end(facts)

    @contextmanager
    def _running_job(self, job_id: uuid.UUID) -> Iterator[dict[str, object]]:
        """Count the job as running and bind its id to log lines.

        Yields the facts that log lines of the job carry.
        """
        with self._lock:
            self._running[job_id] += 1
            instruments.JOBS_RUNNING.set(len(self._running))
        try:
            with (
                structlog.contextvars.bound_contextvars(job_id=str(job_id)),
                log_context() as facts,
            ):
                self._log_begin(job_id)
                yield facts
        finally:
            with self._lock:
                self._running[job_id] -= 1
                self._running = +self._running
                instruments.JOBS_RUNNING.set(len(self._running))

    def _log_begin(self, job_id: uuid.UUID) -> None:
        """Log the job's begin.

        Without a database it is skipped: the next step waits for the database.
        """
        try:
            with self._database.read() as session:
                job = session.get(Job, job_id)
        except sqlalchemy.exc.SQLAlchemyError:
            return
        if job is None:
            return
        waited = (datetime.now(UTC) - job.enqueued_at).total_seconds()
        bind_log_context(meal_id=str(job.meal_id), purpose=job.purpose)
        if job.request_id is not None:
            bind_log_context(request_id=job.request_id)
        if not job.attempts and not job.is_background:
            instruments.JOB_WAIT.observe(max(waited, 0.0))
        log.info("job_begins", attempt=job.attempts + 1, waited_seconds=round(waited, 1))

    def _log_end(self, facts: Mapping[str, object]) -> None:
        """Log and count the job, after its end is committed."""
        outcome = str(facts.get("outcome", "ok"))
        instruments.ESTIMATES.labels(
            facts.get("purpose", "unknown"), instruments.outcome_label(outcome)
        ).inc()
        log.info("job_ended", outcome=outcome)

    def _compute(self, job_id: uuid.UUID) -> Computed | None:
        """Return the sealed result or a failure; None: the job has ended, or another worker has it."""
        result_key: str | None = None
        failed, waits, broken_off, is_background = 0, 0, 0, False
        while True:
            self._raise_if_leaving()
            try:
                if result_key is None:
                    with self._database.write() as session:
                        self._lease.guard(session)
                        job = jobs.start_attempt(
                            session, job_id, self._lease.executor_id, datetime.now(UTC)
                        )
                        if job is None:
                            return None
                        result_key, is_background = job.result_key, job.is_background
                    if result_key is not None:
                        return Computed(result_key)
                    with self._put_off_by_a_fault("compute", job_id):
                        result_key = self._estimate.compute(job_id, is_alone=broken_off > 0)
                with self._database.write() as session:
                    self._lease.guard(session)
                    jobs.keep_result(session, job_id, self._lease.executor_id, result_key)
                return Computed(result_key)
            except JobFailure as error:
                return Computed(None, error.failure)
            except BrokenOff as error:
                self._raise_if_leaving()  # this worker killed it, because it stops
                # tried alone, it would make meals wait
                if is_background or broken_off >= TRIES_ALONE:
                    return Computed(None, _after_tries(error.failure, 1 + broken_off))
                self._estimate.await_room(job_id)
                self._leaving.wait(self._times.wait_for_room * 4**broken_off)
                broken_off += 1
                continue
            except Exception as error:  # noqa: BLE001  # the worker's edge: _note_failed_step logs it
                self._raise_if_leaving()  # a child that was killed because this worker stops looks like a fault
                failed += not is_passing(error)
                _note_failed_step("compute", error)
                if failed >= TRIES:
                    return Computed(None, INTERNAL_ERROR)
            self._wait(waits)
            waits += 1

    def _persist(self, job_id: uuid.UUID, computed: Computed) -> bool:
        """Retry until the job's end is committed; if the result cannot be saved, the meal fails.

        Returns False if the end was committed before or another worker has the job.
        """
        result: SealedAnswer | None = None
        failed, waits = 0, 0
        while True:
            self._raise_if_leaving()
            try:
                if computed.result_key is not None and result is None:
                    # before the transaction, which would block others while it waits for the store
                    with self._put_off_by_a_fault("load", job_id):
                        result = self._estimate.load(computed.result_key)
                with self._database.write() as session:
                    return self._finish(session, job_id, result, computed.failure)
            except Exception as error:
                failed += not is_passing(error)
                _note_failed_step("save", error)
                if failed >= 2 * TRIES:
                    raise  # not even the failure can be saved: the job is queued again, and fails after some takeovers
                if failed >= TRIES:
                    computed, result = Computed(None, INTERNAL_ERROR), None
            self._wait(waits)
            waits += 1

    def _finish(
        self,
        session: Session,
        job_id: uuid.UUID,
        result: SealedAnswer | None,
        failure: Failure | None,
    ) -> bool:
        self._lease.guard(session)
        live = jobs.lock_live_job(session, job_id)
        if live is None or live[0].executor_id != self._lease.executor_id:
            return False
        job, meal = live
        if result is not None:
            try:
                with session.begin_nested():
                    self._estimate.save(session, job_id, result)
            except JobFailure as error:
                failure = error.failure
        now = datetime.now(UTC)
        if failure is None:
            jobs.finish_job(job, now)
            return True
        bind_log_context(outcome=failure.code)
        jobs.fail_job(job, meal, failure, now)
        if job.purpose != "meal":
            self._estimate.settle(session, meal)
        return True

    @contextmanager
    def _put_off_by_a_fault(self, step: str, job_id: uuid.UUID) -> Iterator[None]:
        """Give the job back for a while if the step meets a passing fault: raises JobLeft.

        The fault itself is raised if the database is away as well.
        """
        try:
            yield
        except Exception as error:
            self._raise_if_leaving()
            if not is_passing(error) or not self._is_put_off(job_id):
                raise
            _note_failed_step(step, error)
            raise JobLeft from error

    def _is_put_off(self, job_id: uuid.UUID) -> bool:
        try:
            with self._database.write() as session:
                self._lease.guard(session)
                jobs.put_off(
                    session, job_id, self._lease.executor_id, datetime.now(UTC), self._times
                )
        except sqlalchemy.exc.SQLAlchemyError:
            return False
        return True

    def _raise_if_leaving(self) -> None:
        if self._leaving.is_set():
            raise JobLeft

    def _wait(self, waits_before: int) -> None:
        self._leaving.wait(min(self._times.first_wait * 2**waits_before, self._times.longest_wait))


def _after_tries(failure: Failure, tries: int) -> Failure:
    return replace(failure, message=f"{failure.message} It was tried {tries} times.")


def _note_failed_step(step: str, error: Exception) -> None:
    """Log and count a failed step."""
    passing = is_passing(error)
    log.warning("job_step_failed", step=step, passing=passing, exc_info=error)
    instruments.JOB_STEPS_FAILED.labels(step, "yes" if passing else "no").inc()
