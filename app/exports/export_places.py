"""Limits on concurrent exports: each has a process, and a copy of its rows or photographs on the disk."""

import threading
import uuid
from collections import Counter
from collections.abc import Callable

from app.core.errors import UnavailableError

OPEN_A_PERSON = 2  # one more than needed: an interrupted download may seem open for some minutes
OPEN_AT_ONCE = 8
PROCESSES = 1  # that write files at once, of some 500 MB each; further exports wait
RETRY_AFTER_SECONDS = 60


class ExportPlaces:
    """The open exports of this process."""

    def __init__(self) -> None:
        self._open: Counter[uuid.UUID] = Counter()
        self._lock = threading.Lock()
        self.processes = threading.Semaphore(PROCESSES)

    def take(self, person_id: uuid.UUID) -> Callable[[], None]:
        """Take a place; return the function that gives it back. Raises UnavailableError (`server_busy`)."""
        with self._lock:
            if self._open[person_id] >= OPEN_A_PERSON or self._open.total() >= OPEN_AT_ONCE:
                raise UnavailableError(
                    "Other exports are running: try again in a minute.",
                    code="server_busy",
                    retry_after_seconds=RETRY_AFTER_SECONDS,
                )
            self._open[person_id] += 1

        def leave() -> None:
            with self._lock:
                self._open[person_id] -= 1
                self._open = +self._open

        return leave
