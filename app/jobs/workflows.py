"""The workflow of one estimate: compute, then save in one transaction with the job's end. The use cases are injected.

Computing may happen twice (a worker dies after it); saving happens once: in its transaction the worker's lease is held,
the job is locked and found unfinished, and DBOS's checkpoint is written. Passing faults are waited out, bugs are tried
a few times and then end as a failed meal; the worker goes on.
"""

import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import Any, Literal, Protocol, TypedDict

import sqlalchemy.exc
import structlog
from dbos import DBOS, SQLAlchemyDatasource
from sqlalchemy.orm import Session

from app.db.models import Meal
from app.db.queries import jobs
from app.db.session import Database
from app.errors import Failure
from app.jobs.faults import INTERNAL_ERROR, BrokenOff, JobFailure, JobLeft, TryAgain, is_passing
from app.jobs.leases import Lease
from app.jobs.times import WorkerTimes
from app.logs import tell, telling
from app.metrics import instruments

log = structlog.get_logger()

IsolationLevel = Literal["SERIALIZABLE", "READ COMMITTED"]

TRIES = 3  # of what looks like a bug, in one claim of the job
TRIES_ALONE = 2  # more, of what was killed or took too long


class EstimateUseCases(Protocol):
    """What services do for a job: compute; load what that sealed, maybe in another worker; save it.

    compute and save may raise JobFailure: the meal fails with its code. A passing fault (is_passing) is tried again
    without end, any other exception a few times.
    """

    def compute(self, job_id: uuid.UUID, *, is_alone: bool) -> str:
        """Run the pipeline, seal what it made in the blob store, return the key of the sealed result.

        May run more than once for a job, also at the same time on two workers. Writes no row but the progress.
        is_alone: while this worker estimates nothing else. Raises BrokenOff where that may help.
        """
        ...

    def await_room(self, job_id: uuid.UUID) -> object:
        """The job waits to be computed again: the phone is told so. A fault of this must not be raised."""
        ...

    def load(self, result_key: str) -> object:
        """Fetch the sealed result: outside of any transaction, since the store may be slow."""
        ...

    def save(self, session: Session, job_id: uuid.UUID, result: Any) -> None:
        """Write run, items, records and the meal's status in this transaction. It is committed at most once.

        result: as `load` gave it.
        """
        ...

    def abandon(self, job_id: uuid.UUID) -> object:
        """Nobody wants the job's result any more: a `compute` of it under way may end, in whatever way, soon."""
        ...

    def settle(self, session: Session, meal: Meal) -> object:
        """Bring the meal's records in line: a job of its ended without a result, one for more than its own pair."""
        ...


class SaveError(Exception):
    """Saving failed by what looks like a bug; the log has it whole."""


class Computed(TypedDict):
    """What DBOS keeps of the first step: ids, keys and codes only."""

    result_key: str | None
    failure: dict[str, str] | None


class EstimateWorkflow:
    """One a worker process."""

    def __init__(self, database: Database, lease: Lease, use_cases: EstimateUseCases, times: WorkerTimes) -> None:
        self._database = database
        self._lease = lease
        self._use_cases = use_cases
        self._times = times
        self._leaving = threading.Event()
        self._running: Counter[str] = Counter()
        self._lock = threading.Lock()

    @property
    def running(self) -> frozenset[str]:
        """Ids of the jobs that this process works on now."""
        with self._lock:
            return frozenset(+self._running)

    def leave(self) -> None:
        """Let go of all jobs at the next opportunity: the process ends."""
        self._leaving.set()

    def wait_until_idle(self, seconds: float) -> bool:
        """Whether no job runs any more within that time."""
        deadline = time.monotonic() + seconds
        while self.running:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
        return True

    def bind(self, datasource: SQLAlchemyDatasource) -> Callable[[str], str]:
        """The workflow's function over the datasource of its transactions. Its argument and result go into DBOS."""
        isolation: IsolationLevel = "SERIALIZABLE" if self._database.is_sqlite else "READ COMMITTED"

        @datasource.transaction(name="finish", isolation_level=isolation)
        def finish(job_id: str, result: object | None, failure: dict[str, str] | None) -> str:
            return self._finish(datasource.sql_session(), uuid.UUID(job_id), result, failure)

        def estimate_meal(job_id: str) -> str:
            with self._at_work_on(job_id) as facts:
                computed = DBOS.run_step({"name": "compute"}, self._compute, job_id)
                if computed["result_key"] is None and computed["failure"] is None:
                    return "was finished before"
                end = self._persist(finish, job_id, computed)
                if end in ("done", "failed"):
                    self._tell_end(facts)
                return end

        return estimate_meal

    @contextmanager
    def _at_work_on(self, job_id: str) -> Iterator[dict[str, Any]]:
        """Count it, and name it in all that is logged meanwhile. Yields the facts that were told of it."""
        with self._lock:
            self._running[job_id] += 1
            instruments.JOBS_RUNNING.set(len(self._running))
        try:
            with structlog.contextvars.bound_contextvars(job_id=job_id), telling() as facts:
                self._tell_names(job_id)
                yield facts
        finally:
            with self._lock:
                self._running[job_id] -= 1
                self._running = +self._running
                instruments.JOBS_RUNNING.set(len(self._running))

    def _tell_names(self, job_id: str) -> None:
        """A job runs also if its names cannot be asked for: the step after this waits for the database."""
        try:
            with self._database.read() as session:
                names = jobs.names_of_job(session, uuid.UUID(job_id))
        except sqlalchemy.exc.SQLAlchemyError:
            return
        if names is None:
            return
        waited = (datetime.now(UTC) - names.enqueued_at).total_seconds()
        tell(meal_id=str(names.meal_id), purpose=names.purpose)
        if names.request_id is not None:
            tell(request_id=names.request_id)
        if not names.attempts:
            instruments.JOB_WAIT.observe(max(waited, 0.0))
        log.info("job_begins", attempt=names.attempts + 1, waited_seconds=round(waited, 1))

    def _tell_end(self, facts: Mapping[str, Any]) -> None:
        """Once its end is committed."""
        outcome = facts.get("outcome", "ok")
        instruments.ESTIMATES.labels(facts.get("purpose", "unknown"), instruments.outcome_label(outcome)).inc()
        log.info("job_ended", outcome=outcome)

    def _compute(self, job_id: str) -> Computed:
        failed, waits, broken_off = 0, 0, 0
        while True:
            self._go_on_or_leave()
            try:
                with self._database.write() as session:
                    self._lease.guard(session)
                    now = datetime.now(UTC)
                    if not jobs.start_attempt(session, uuid.UUID(job_id), self._lease.executor_id, now):
                        return Computed(result_key=None, failure=None)
                key = self._use_cases.compute(uuid.UUID(job_id), is_alone=broken_off > 0)
                return Computed(result_key=key, failure=None)
            except JobFailure as error:
                return Computed(result_key=None, failure=asdict(error.failure))
            except BrokenOff as error:
                self._go_on_or_leave()  # we killed it, since we stop
                if broken_off >= TRIES_ALONE:
                    return Computed(result_key=None, failure=asdict(_after_tries(error.failure, 1 + broken_off)))
                self._use_cases.await_room(uuid.UUID(job_id))
                self._leaving.wait(self._times.wait_for_room * 4**broken_off)
                broken_off += 1
                continue
            except Exception as error:  # noqa: BLE001  # the worker's edge: _note_failed_step logs it whole
                self._go_on_or_leave()  # a child that was killed because we stop looks like a fault
                failed += not is_passing(error)
                _note_failed_step("compute", error, passing=is_passing(error))
                if failed >= TRIES:
                    return Computed(result_key=None, failure=asdict(INTERNAL_ERROR))
            self._wait(waits)
            waits += 1

    def _persist(
        self, finish: Callable[[str, object | None, dict[str, str] | None], str], job_id: str, computed: Computed
    ) -> str:
        """Run the transaction until it is committed; a result that cannot be saved ends as a failed meal.

        DBOS records each exception as a step's outcome and replays it after a takeover, so the count goes on there.
        """
        result_key, failure = computed["result_key"], computed["failure"]
        result: object | None = None
        failed, waits = 0, 0
        while True:
            self._go_on_or_leave()
            try:
                if result_key is not None and result is None:
                    result = self._load(result_key)
                return finish(job_id, result, failure)
            except TryAgain as error:
                _note_failed_step("save", error.__cause__, passing=True)
            except Exception:
                failed += 1
                if failed >= 2 * TRIES:
                    raise  # not even the failure can be saved: the sweep finds the ended workflow
                if failed >= TRIES:
                    result_key, result, failure = None, None, asdict(INTERNAL_ERROR)
            self._wait(waits)
            waits += 1

    def _load(self, result_key: str) -> object:
        """Before the transaction: one that waits for the store would lose its connection, and hold up all others."""
        try:
            return self._use_cases.load(result_key)
        except Exception as error:
            if is_passing(error):
                raise TryAgain from error
            _note_failed_step("load", error, passing=False)
            raise

    def _finish(
        self, session: Session, job_id: uuid.UUID, result: object | None, failure: dict[str, str] | None
    ) -> str:
        try:
            self._lease.guard(session)
            found = jobs.lock_live_job(session, job_id)
            if found is None:  # committed before, by a worker that died before it could tell DBOS
                return "was finished before"
            job, meal = found
            if result is not None:
                try:
                    with session.begin_nested():
                        self._use_cases.save(session, job_id, result)
                except JobFailure as error:
                    failure = asdict(error.failure)
            now = datetime.now(UTC)
            if failure is not None:
                tell(outcome=failure["code"])
                jobs.fail_job(job, meal, Failure(**failure), now)
                if job.purpose != "meal":
                    self._use_cases.settle(session, meal)
                return "failed"
            jobs.finish_job(job, now)
        except Exception as error:
            if is_passing(error):
                raise TryAgain from error
            _note_failed_step("save", error, passing=False)
            # DBOS keeps what is raised here, and a database's error quotes the row: the name is all that it gets
            raise SaveError(type(error).__name__) from None
        return "done"

    def _go_on_or_leave(self) -> None:
        if self._leaving.is_set():
            raise JobLeft

    def _wait(self, waits_before: int) -> None:
        self._leaving.wait(min(self._times.first_wait * 2**waits_before, self._times.longest_wait))


def _after_tries(failure: Failure, tries: int) -> Failure:
    return replace(failure, message=f"{failure.message} It was tried {tries} times.")


def _note_failed_step(step: str, error: BaseException | None, *, passing: bool) -> None:
    """Into the log, whole, and the figures."""
    log.warning("job_step_failed", step=step, passing=passing, exc_info=error)
    instruments.JOB_STEPS_FAILED.labels(step, "yes" if passing else "no").inc()
