"""Watches the jobs from beside, around all proxies: how long the job of a dead worker waits for another.

A worker's executor id holds its process id (leases.new_executor), so a death is matched with the jobs that it had.
"""

import threading
import time
from dataclasses import dataclass

import sqlalchemy as sa

from app.db.session import normalise_url

LOOK_SECONDS = 0.2
JOBS = sa.text("SELECT id, state, executor_id FROM job")


@dataclass(frozen=True)
class Takeover:
    """seconds: from the death to the sight of another worker at the job. beside: what else was wrong meanwhile."""

    seconds: float
    beside: tuple


class Witness(threading.Thread):
    """Looks at the table of jobs again and again; a look that fails (the database is away) is left out."""

    def __init__(self, url, journal):
        super().__init__(name="witness", daemon=True)
        self._engine = sa.create_engine(
            normalise_url(url),
            poolclass=sa.NullPool,
            isolation_level="AUTOCOMMIT",
            connect_args={"timeout": 2} if url.startswith("sqlite") else {"connect_timeout": 2},
        )
        self._journal = journal
        self._lock = threading.Lock()
        self._seen = {}
        self._orphaned = {}
        self._faults = []
        self._ending = threading.Event()
        self.takeovers = []

    def note(self, name):
        """A fault begins."""
        self._journal.note(f"begins: {name}")
        with self._lock:
            self._faults.append([name, time.monotonic(), None])

    def good_answers(self):
        """How many the phones have heard."""
        return self._journal.good_answers

    def passed(self, name):
        self._journal.note(f"passed: {name}")
        with self._lock:
            for fault in reversed(self._faults):
                if fault[0] == name and fault[2] is None:
                    fault[2] = time.monotonic()
                    return

    def worker_dies(self, pid):
        """Call it just before: the jobs that it has now are to be taken over."""
        with self._lock:
            for job in self._jobs_of(pid):
                self._orphaned.setdefault(job, (self._seen[job][1], time.monotonic()))
                self._journal.note(f"job {job} loses its worker, process {pid}")

    def has_job(self, pid):
        with self._lock:
            return bool(self._jobs_of(pid))

    def _jobs_of(self, pid):
        return [
            job
            for job, (state, executor) in self._seen.items()
            if state == "processing" and executor is not None and executor.split("-")[-2] == str(pid)
        ]

    def run(self):
        while not self._ending.wait(LOOK_SECONDS):
            try:
                with self._engine.connect() as connection:
                    rows = connection.execute(JOBS).all()
            except sa.exc.SQLAlchemyError:
                continue
            with self._lock:
                self._seen = {str(job): (state, executor) for job, state, executor in rows}
                self._find_taken_over()

    def stop(self):
        self._ending.set()
        self.join()
        self._engine.dispose()

    def pid_at_work(self, seconds=60.0):
        """The process of a worker that has a job, as soon as there is one; None: there was none in time."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            with self._lock:
                for state, executor in self._seen.values():
                    if state == "processing" and executor is not None:
                        return int(executor.split("-")[-2])
            time.sleep(0.05)
        return None

    def waiting(self):
        """Jobs of dead workers that nobody has taken over yet."""
        with self._lock:
            return dict(self._orphaned)

    def _find_taken_over(self):
        now = time.monotonic()
        for job, (executor, since) in list(self._orphaned.items()):
            state, having = self._seen.get(job, ("erased", None))
            if having == executor and state == "processing":
                continue
            del self._orphaned[job]
            if having != executor and state != "erased":  # else it had ended before the worker did, or is erased
                beside = {name for name, began, ended in self._faults if began < now and (ended or now) > since}
                self._journal.note(f"job {job} is taken over, {state}")
                self.takeovers.append(Takeover(now - since, tuple(sorted(beside))))
