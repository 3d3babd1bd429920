"""The worker's chores for exports and releases: runs a side process that makes them, and expires exports.

The side process makes one export or release, prints its outcome as a line of JSON, and exits. It runs at a lower
priority than estimates, dies with the worker (process_life.py), and gets SIGTERM when the worker ends.
"""

import json
import os
import subprocess
import sys
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta

import structlog

from app.core.settings import Settings
from app.db.session import Database
from app.exports import file_work_queries as file_work
from app.exports import queries as exports
from app.jobs.supervisor import settings_environment
from app.metrics import instruments

log = structlog.get_logger()

COMMAND = (sys.executable, "-m", "app.file_worker")
END_SECONDS = 3.0  # between SIGTERM and SIGKILL
BATCH = 200
LISTED_FOR = timedelta(days=30)  # exports without a file, after their end


class FileProcess:
    """At most one side process of a worker. Used by one thread, which must outlive the processes.

    command, lease_seconds: set by tests.
    """

    def __init__(
        self,
        database: Database,
        settings: Settings,
        *,
        command: Sequence[str] = COMMAND,
        lease_seconds: float = file_work.LEASE_SECONDS,
    ) -> None:
        self._database, self._command, self._lease_seconds = database, command, lease_seconds
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
        self._environment = inherited | settings_environment(settings)
        self._process: subprocess.Popen[bytes] | None = None
        self._claim = uuid.uuid4()

    @property
    def pid(self) -> int | None:
        """The running process's id."""
        return self._process.pid if self._process is not None else None

    def look(self) -> None:
        """Clean up after an ended process, and start one if there is work and none runs. Returns at once."""
        if self._process is not None:
            if self._process.poll() is None:
                return
            self._clean_up(self._process, is_stopped=False)
        with self._database.read() as session:
            if not file_work.has_work(session, self._lease_seconds):
                return
        self._claim = uuid.uuid4()
        self._process = subprocess.Popen(
            [*self._command, "--parent", str(os.getpid()), "--claim", self._claim.hex],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )

    def stop(self) -> None:
        """Terminate the process, kill it if it does not end, and clean up after it."""
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._clean_up(self._process, is_stopped=True)

    def _clean_up(self, process: subprocess.Popen[bytes], *, is_stopped: bool) -> None:
        """Count the outcome; release the claim of a process that died at once, not when its lease ends.

        is_stopped: `stop` ended it, which does not count as an attempt.
        """
        with process:
            ended = _last_line(process.stdout.read() if process.stdout is not None else b"")
        self._process = None
        if ended is None:
            log.warning("side_process_died", status=process.returncode)
            with self._database.write() as session:
                file_work.put_back(session, self._claim, counts=not is_stopped)
            instruments.FILES_MADE.labels("export", "again" if is_stopped else "died").inc()
        elif ended:
            instruments.FILES_MADE.labels(ended["kind"], instruments.outcome_label(ended["outcome"])).inc()


def expire_exports(database: Database, now: datetime | None = None) -> int:
    """Expire exports whose time is over, and delete old rows without a file. Returns the number of expired exports."""
    now, total = now or datetime.now(UTC), 0
    while True:
        with database.write() as session:
            count = exports.expire_due(session, now, BATCH)
            exports.forget_ended(session, now - LISTED_FOR)
        total += count
        if count < BATCH:
            return total


def _last_line(output: bytes) -> Mapping[str, str] | None:
    """Return the outcome that the process printed, empty if there was no work; None if it did not end by itself."""
    try:
        ended: object = json.loads(output.splitlines()[-1])
    except (ValueError, IndexError):
        return None
    return ended if isinstance(ended, dict) else None
