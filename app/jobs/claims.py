"""Claims jobs for one worker: never more than it has room for, and the next as soon as a child is free.

A claim is one short transaction (jobs/queries.py, claim_jobs) under the worker's lease. Each claimed job runs in a
thread of its own.
"""

import random
import threading
import uuid
from collections.abc import Callable

import structlog

from app.children.faults import JobLeft
from app.db.session import Database
from app.jobs import queries as jobs
from app.jobs.leases import Lease

log = structlog.get_logger()

POLL_SECONDS = 0.25  # how long a meal waits for an idle worker to look
STOP_SECONDS = 5.0  # for a claim under way to end


class Claims:
    """One per worker process. run: performs a job. protocol: of this program; jobs of a higher one are left alone."""

    def __init__(
        self,
        database: Database,
        lease: Lease,
        run: Callable[[uuid.UUID], object],
        *,
        concurrency: int,
        protocol: int,
    ) -> None:
        self._database = database
        self._lease = lease
        self._run = run
        self._concurrency = concurrency
        self._protocol = protocol
        self._claimed: set[uuid.UUID] = set()
        self._computed: set[uuid.UUID] = set()  # of those: only what is to be sealed and saved is left
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._look = threading.Event()
        self._thread = threading.Thread(target=self._claim_until_the_end, name="claims", daemon=True)

    def start(self) -> None:
        """Begin to claim."""
        self._thread.start()

    def stop(self) -> None:
        """Claim no further job; those that were claimed go on."""
        self._ending.set()
        self._look.set()
        self._thread.join(STOP_SECONDS)

    def note_computed(self, job_id: str) -> None:
        """The job needs no child any more: while its result is sealed and saved, the next job may have it."""
        with self._lock:
            if uuid.UUID(job_id) in self._claimed:
                self._computed.add(uuid.UUID(job_id))
        self._look.set()

    def note_computing(self, job_id: str) -> None:
        """The job needs a child, maybe again: its result could not be sealed."""
        with self._lock:
            self._computed.discard(uuid.UUID(job_id))

    def _claim_until_the_end(self) -> None:
        while not self._ending.is_set():
            self._look.clear()
            try:
                self._claim_what_there_is_room_for()
            except JobLeft:  # the lease is lost: the heartbeats notice it and end the process
                pass
            except Exception as error:  # the worker's edge: the database comes back
                if not self._ending.is_set():
                    log.warning("claim_failed", exc_info=error)
            self._look.wait(POLL_SECONDS * random.uniform(0.9, 1.1))  # noqa: S311  # workers should not look in step

    def _claim_what_there_is_room_for(self) -> None:
        with self._lock:
            claimed, computed = len(self._claimed), len(self._computed)
        room = self._concurrency - claimed + min(computed, self._concurrency)  # a slow store piles up no results
        if room <= 0:
            return
        with self._database.read() as session:  # an idle worker keeps no writer waiting
            if not jobs.is_any_waiting(session, self._protocol):
                return
        with self._database.write() as session:
            self._lease.guard(session)
            job_ids = jobs.claim_jobs(session, self._lease.executor_id, protocol=self._protocol, room=room)
        with self._lock:
            self._claimed.update(job_ids)
        for job_id in job_ids:
            threading.Thread(target=self._perform, args=(job_id,), name=f"job-{job_id}", daemon=True).start()

    def _perform(self, job_id: uuid.UUID) -> None:
        try:
            self._run(job_id)
        except JobLeft:
            pass
        except Exception:  # the worker's edge: job_worker.py finds the job claimed and not running
            log.exception("job_broken_off", job_id=str(job_id))
        finally:
            with self._lock:
                self._claimed.discard(job_id)
                self._computed.discard(job_id)
            self._look.set()  # there is room again
