"""Keep one worker process running beside the server: start it, restart it when it ends, end it with the server."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence

import structlog
from pydantic import SecretStr

from app.core.settings import Settings

log = structlog.get_logger()

LEASE_LOST = 75  # exit status of a worker that lost its lease (EX_TEMPFAIL): restart it at once
FIRST_WAIT_SECONDS = 0.5
LONGEST_WAIT_SECONDS = 30.0
STEADY_SECONDS = 60.0  # a worker that ran so long is restarted after the first wait again
STOP_SECONDS = 12.0  # it hands its jobs back within ten seconds
WORKER_COMMAND = (sys.executable, "-m", "app.worker")


def settings_environment(settings: Settings) -> dict[str, str]:
    """Return the environment variables from which another process reads the same settings."""
    values = settings.model_dump(mode="json", exclude_none=True)
    for name in values:
        value = getattr(settings, name)
        if isinstance(value, SecretStr):
            values[name] = value.get_secret_value()
    return {
        f"TADA_{name.upper()}": value if isinstance(value, str) else json.dumps(value)
        for name, value in values.items()
    }


class WorkerProcess:
    """`python -m app.worker`, supervised.

    It dies with this process, even on SIGKILL (process_life.py).
    """

    def __init__(
        self,
        settings: Settings,
        command: Sequence[str] = WORKER_COMMAND,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._command = [*command, "--parent", str(os.getpid())]
        # the latter would let it count together with the server's processes
        others = ("TADA_", "PROMETHEUS_")
        inherited = {
            name: value for name, value in os.environ.items() if not name.startswith(others)
        }
        self._environment = inherited | settings_environment(settings) | dict(environment or {})
        self._stopping = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    @property
    def pid(self) -> int | None:
        """The running process's id."""
        with self._lock:
            return self._process.pid if self._process is not None else None

    def start(self) -> None:
        """Start supervising; returns at once."""
        # the kernel ends the worker with the thread that started it; this one runs until stop()
        self._thread = threading.Thread(
            target=self._supervise, name="worker-supervisor", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Ask the worker to hand its jobs back and exit; kill it if it does not."""
        self._stopping.set()
        with self._lock:
            if self._process is not None:
                self._process.terminate()
        if self._thread is not None:
            self._thread.join(STOP_SECONDS)
        with self._lock:
            if self._process is not None:
                self._process.kill()
        if self._thread is not None:
            self._thread.join()

    def _supervise(self) -> None:
        wait = FIRST_WAIT_SECONDS
        while True:
            began = time.monotonic()
            with self._lock:
                if self._stopping.is_set():
                    return
                self._process = process = subprocess.Popen(
                    self._command, env=self._environment, stdin=subprocess.DEVNULL
                )
            status = process.wait()
            with self._lock:
                self._process = None
            if self._stopping.is_set():
                return
            lived = time.monotonic() - began
            log.warning("worker_ended", status=status, lived_seconds=round(lived, 1))
            if status == LEASE_LOST or lived > STEADY_SECONDS:
                wait = FIRST_WAIT_SECONDS
            self._stopping.wait(wait)
            wait = min(wait * 2, LONGEST_WAIT_SECONDS)
