"""Claim jobs for one worker: never more than it has room for, and the next one as soon as a child is free.

A claim is one short transaction (jobs/queries.py, claim_jobs) under the worker's lease. Each
claimed job runs in its own thread.

Background jobs must not delay a meal that a phone waits for. They are queued (backlog) and claimed
only while nothing else waits, on all cores but one; if a meal waits and every core is busy, one of
them is ended and handed back.
"""

import random
import threading
import time
import uuid
from collections.abc import Callable

import structlog

from app.children.faults import JobLeft
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.leases import Lease

log = structlog.get_logger()

POLL_SECONDS = 0.25  # the longest that a meal waits for an idle worker
BACKLOG_SECONDS = 1.0  # between two looks for background work, if the last one found none
STOP_SECONDS = 5.0  # for a claim in progress to end


Backlog = Callable[[int], int]


def no_backlog(room: int) -> int:
    """Queue no background jobs."""
    del room
    return 0


class Claims:
    """One per worker process.

    run: performs a job
    protocol: this program's; jobs of a higher one are not claimed
    backlog: queues up to so many background jobs and returns their number
    abandon: ends the estimate of a job
    """

    def __init__(
        self,
        database: Database,
        lease: Lease,
        run: Callable[[uuid.UUID], object],
        *,
        concurrency: int,
        protocol: int,
        backlog: Backlog = no_backlog,
        abandon: Callable[[uuid.UUID], object] = lambda _: None,
    ) -> None:
        self._database = database
        self._lease = lease
        self._run = run
        self._concurrency = concurrency
        self._protocol = protocol
        self._backlog = backlog
        self._abandon = abandon
        self._next_backlog = 0.0
        self._claimed: set[uuid.UUID] = set()
        self._background: set[uuid.UUID] = set()  # those of them that are background jobs
        self._handed_back: set[uuid.UUID] = set()  # those of them that must make room
        # those of them that only wait to be sealed and saved
        self._computed: set[uuid.UUID] = set()
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._look = threading.Event()
        self._thread = threading.Thread(
            target=self._claim_until_stopped, name="claims", daemon=True
        )

    def start(self) -> None:
        """Start to claim jobs."""
        self._thread.start()

    def stop(self) -> None:
        """Claim no further job; claimed jobs go on."""
        self._ending.set()
        self._look.set()
        self._thread.join(STOP_SECONDS)

    def note_computed(self, job_id: str) -> None:
        """The job no longer needs a child: while its result is sealed and saved, the next job may use it."""
        with self._lock:
            if uuid.UUID(job_id) in self._claimed:
                self._computed.add(uuid.UUID(job_id))
        self._look.set()

    def note_computing(self, job_id: str) -> None:
        """The job needs a child, perhaps again, because its result could not be sealed."""
        with self._lock:
            self._computed.discard(uuid.UUID(job_id))

    def _claim_until_stopped(self) -> None:
        while not self._ending.is_set():
            self._look.clear()
            try:
                self._claim_up_to_capacity()
            except JobLeft:  # the lease is lost: the heartbeat notices it and ends the process
                pass
            except Exception as error:  # the worker's edge: the database comes back
                if not self._ending.is_set():
                    log.warning("claim_failed", exc_info=error)
            self._look.wait(POLL_SECONDS * random.uniform(0.9, 1.1))  # noqa: S311  # workers should not poll in step

    def _claim_up_to_capacity(self) -> None:
        with self._lock:
            claimed, computed = len(self._claimed), len(self._computed)
        # so that results do not pile up before a slow store
        room = self._concurrency - claimed + min(computed, self._concurrency)
        with self._lock:
            background, handed_back = len(self._background), set(self._handed_back)
        if room <= 0 and not background:
            return
        with self._database.read() as session:  # a read, so that an idle worker blocks no writer
            kind = jobs.waiting_kind(session, self._protocol)
        is_background = kind != "ordinary"
        if is_background:
            room = min(room, max(1, self._concurrency - 1) - background)
        elif room <= 0:
            self._make_room(handed_back)
            return
        if room <= 0 or (kind is None and not self._queue_backlog(room)):
            return
        with self._database.write() as session:
            self._lease.guard(session)
            job_ids = jobs.claim_jobs(
                session,
                self._lease.executor_id,
                protocol=self._protocol,
                room=room,
                is_background=is_background,
                but=handed_back,
            )
        with self._lock:
            self._claimed.update(job_ids)
            if is_background:
                self._background.update(job_ids)
        for job_id in job_ids:
            threading.Thread(
                target=self._perform, args=(job_id,), name=f"job-{job_id}", daemon=True
            ).start()

    def _queue_backlog(self, room: int) -> int:
        """Queue background jobs, if there are any. Returns their number."""
        if time.monotonic() < self._next_backlog:
            return 0
        queued = self._backlog(room)
        if not queued:
            self._next_backlog = time.monotonic() + BACKLOG_SECONDS
        return queued

    def _make_room(self, handed_back: set[uuid.UUID]) -> None:
        """Hand one background job back, and end its estimate; one that is still ending makes room by itself."""
        if not handed_back:
            with self._lock:
                chosen = sorted(self._background - self._computed)[:1]
            if not chosen:
                return
            with self._database.write() as session:
                self._lease.guard(session)
                if not jobs.release_claims(
                    session, self._lease.executor_id, chosen, is_takeover=False
                ):
                    return  # it is just being saved
            with self._lock:
                handed_back = self._claimed.intersection(chosen)
                self._handed_back |= handed_back
            log.info("background_job_handed_back", job_id=str(chosen[0]))
        for job_id in handed_back:
            self._abandon(job_id)

    def _perform(self, job_id: uuid.UUID) -> None:
        try:
            self._run(job_id)
        except JobLeft:
            pass
        # the worker's edge: job_worker.py finds jobs that are claimed but not running
        except Exception:
            log.exception("job_broken_off", job_id=str(job_id))
        finally:
            with self._lock:
                for job_ids in (self._claimed, self._computed, self._background, self._handed_back):
                    job_ids.discard(job_id)
            self._look.set()  # there is room again
