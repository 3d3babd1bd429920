"""Runs a task on the live tables in a process of its own, which ends with it (app/file_worker.py).

DuckDB brings its own SQLite, so no process that has opened the database may attach it there.
"""

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import structlog
from pydantic import JsonValue

from app.core.errors import StorageFullError, TadaError, UnavailableError
from app.db.session import Database

log = structlog.get_logger()

COMMAND = (sys.executable, "-m", "app.file_worker")
LOOK_SECONDS = 0.2
ROOM_LOOK_SECONDS = 2.0


class FileTaskError(Exception):
    """The process failed: a defect."""


class FileTasks:
    """Starts tasks, each in a process.

    folder: for what does not fit into memory, removed with the task.
    min_free_bytes: of the folder's disk, below which a task is ended.
    niceness: added to this process's own.
    """

    def __init__(
        self, database: Database, folder: Path, min_free_bytes: int, *, niceness: int = 0
    ) -> None:
        self._url, self._folder = database.url, folder
        self._min_free_bytes, self._niceness = min_free_bytes, niceness

    def run(
        self,
        task: str,
        request: Mapping[str, JsonValue],
        *,
        most_seconds: float,
        watch: Callable[[], None] = lambda: None,
    ) -> dict[str, JsonValue]:
        """Run a task to its end in the calling thread; return its answer.

        watch: called some times a second; what it raises ends the process.
        Raises StorageFullError, UnavailableError, FileTaskError.
        """
        with tempfile.TemporaryDirectory(prefix="task-", dir=self._folder) as folder:
            message = {
                "task": task,
                "parent": os.getpid(),
                "niceness": self._niceness,
                "database_url": self._url,
                "folder": folder,
                "request": dict(request),
            }
            with subprocess.Popen(
                COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE
            ) as process:
                try:
                    _send(process, message)
                    self._wait(process, time.monotonic() + most_seconds, watch)
                except BaseException:
                    process.kill()
                    raise
                answer = process.stdout.read() if process.stdout is not None else b""
        return _read(answer)

    def _wait(
        self, process: subprocess.Popen[bytes], until: float, watch: Callable[[], None]
    ) -> None:
        room_looked_at = -math.inf
        while True:
            now = time.monotonic()
            if now - room_looked_at > ROOM_LOOK_SECONDS:
                room_looked_at = now
                if shutil.disk_usage(self._folder).free < self._min_free_bytes:
                    raise _no_room()
            try:
                process.wait(LOOK_SECONDS)
            except subprocess.TimeoutExpired:
                watch()
            else:
                return
            if now > until:
                raise UnavailableError("The file takes too long: choose fewer days.")


def _send(process: subprocess.Popen[bytes], message: Mapping[str, object]) -> None:
    if process.stdin is not None:
        with process.stdin as pipe:
            pipe.write(json.dumps(message).encode())


def _read(answer: bytes) -> dict[str, JsonValue]:
    """The answer of a process that has ended."""
    try:
        told: dict[str, dict[str, JsonValue]] = json.loads(answer)
    except ValueError:
        raise FileTaskError("the process died") from None
    if "result" in told:
        return told["result"]
    log.warning("file_task_failed", **told["error"])
    raise _error_of(str(told["error"]["kind"]), str(told["error"]["message"]))


def _error_of(kind: str, message: str) -> Exception:
    if kind == "full":
        return _no_room()
    if kind == "unavailable":
        return UnavailableError("The database cannot be read now: try again later.")
    return FileTaskError(message)


def _no_room() -> TadaError:
    return StorageFullError("The server's disk has no room for the file: try again later.")
