"""The worker's part in making files: a process beside it makes them, one at a time; files whose time is over go.

The process does one piece of work, prints its outcome as a line of JSON, and ends. It runs at a lower priority than
estimates, dies with the worker (process_life.py), and is asked to end (SIGTERM) when the worker ends.
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
END_SECONDS = 3.0  # between asking the process to end and killing it
BATCH = 200
TOLD_FOR = timedelta(days=30)  # what has ended without a file stays in the list so long


class FileProcess:
    """At most one process of one worker. Used by one thread, which lives as long as the processes shall.

    command, lease_seconds: others in tests.
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
        """Of the process that runs now."""
        return self._process.pid if self._process is not None else None

    def look(self) -> None:
        """Clear up after a process that has ended, and start one if there is work and none runs. Returns at once."""
        if self._process is not None:
            if self._process.poll() is None:
                return
            self._clear_up(self._process, is_asked=False)
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
        """Ask the process to end, kill it if it does not, and clear up after it."""
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._clear_up(self._process, is_asked=True)

    def _clear_up(self, process: subprocess.Popen[bytes], *, is_asked: bool) -> None:
        """Count its outcome; the work of a process that died goes back at once, not when its lease ends.

        If it was asked to end and took too long, that counts as no attempt.
        """
        with process:
            ended = _last_line(process.stdout.read() if process.stdout is not None else b"")
        self._process = None
        if ended is None:
            log.warning("side_process_died", status=process.returncode)
            with self._database.write() as session:
                file_work.put_back(session, self._claim, counts=not is_asked)
            instruments.FILES_MADE.labels("export", "again" if is_asked else "died").inc()
        elif ended:
            instruments.FILES_MADE.labels(ended["kind"], instruments.outcome_label(ended["outcome"])).inc()


def expire_exports(database: Database, now: datetime | None = None) -> int:
    """Files whose time is over are to go, and old lines of the list. Returns how many files."""
    now, total = now or datetime.now(UTC), 0
    while True:
        with database.write() as session:
            count = exports.expire_due(session, now, BATCH)
            exports.forget_ended(session, now - TOLD_FOR)
        total += count
        if count < BATCH:
            return total


def _last_line(output: bytes) -> Mapping[str, str] | None:
    """What the process said of its work, empty where there was none; None: it came to no end of its own."""
    try:
        ended: object = json.loads(output.splitlines()[-1])
    except (ValueError, IndexError):
        return None
    return ended if isinstance(ended, dict) else None
