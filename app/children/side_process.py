"""One process beside a worker, for work that would hold up its chores: started when there is something to do.

It does one piece of work, says so in a line of JSON, and ends. It runs at a lower priority than estimates, dies with
the worker (process_life.py), and is asked to end (SIGTERM) when the worker ends.
"""

import json
import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import structlog

log = structlog.get_logger()

END_SECONDS = 3.0  # between asking it to end and killing it


class SideProcess:
    """At most one process at a time. Used by one thread, which lives as long as the processes shall.

    command: `--parent PID --claim TEXT` are added to it. has_work: whether to start one. new_claim: what it shall call
    itself. on_end: called with its claim, its line (None: it died without one), and whether it was asked to end.
    """

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        *,
        has_work: Callable[[], bool],
        new_claim: Callable[[], str],
        on_end: Callable[[str, Mapping[str, Any] | None, bool], None],
    ) -> None:
        self._command, self._environment = command, environment
        self._has_work, self._new_claim, self._on_end = has_work, new_claim, on_end
        self._process: subprocess.Popen[bytes] | None = None
        self._claim = ""

    @property
    def pid(self) -> int | None:
        """Of the process that runs now."""
        return self._process.pid if self._process is not None else None

    def look(self) -> None:
        """See to one that has ended, and start one if there is work and none runs. Returns at once."""
        if self._process is not None:
            if self._process.poll() is None:
                return
            self._see_off(self._process, is_asked=False)
        if not self._has_work():
            return
        self._claim = self._new_claim()
        self._process = subprocess.Popen(
            [*self._command, "--parent", str(os.getpid()), "--claim", self._claim],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )

    def stop(self) -> None:
        """Ask the process to end, kill it if it does not, and see to what it leaves."""
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._see_off(self._process, is_asked=True)

    def _see_off(self, process: subprocess.Popen[bytes], *, is_asked: bool) -> None:
        said = process.stdout.read() if process.stdout is not None else b""
        if process.stdout is not None:
            process.stdout.close()
        self._process = None
        ended = _last_line(said)
        if ended is None:
            log.warning("side_process_died", status=process.returncode)
        self._on_end(self._claim, ended, is_asked)


def _last_line(said: bytes) -> Mapping[str, Any] | None:
    """What it said of its end; None: it came to no end of its own."""
    try:
        ended = json.loads(said.splitlines()[-1])
    except (ValueError, IndexError):
        return None
    return ended if isinstance(ended, dict) else None
