"""Chores: small recurring work of a worker beside its jobs: deliveries, deletions, windows that end.

Every worker does every chore, so a chore must tolerate concurrent runs and being killed halfway.
"""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import structlog

from app.metrics import instruments

log = structlog.get_logger()

LOOK_SECONDS = 0.5


@dataclass(frozen=True, slots=True)
class Chore:
    """run: does the pending work and returns. every_seconds: the shortest time between two starts.

    at_end: runs before the worker ends; it may take a few seconds.
    """

    name: str
    every_seconds: float
    run: Callable[[], object]
    at_end: Callable[[], object] | None = None


class ChoreThread:
    """Runs the chores one after the other, in one thread of a worker, until it is stopped."""

    def __init__(self, chores: Sequence[Chore]) -> None:
        self._chores = chores
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="chores", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self, seconds: float = 2.0) -> None:
        """Start no further chore; wait a little for the one in progress."""
        self._ending.set()
        self._thread.join(seconds)

    def _run(self) -> None:
        try:
            self._run_due_chores()
        finally:
            for chore in self._chores:
                if chore.at_end is not None:
                    _end(chore.name, chore.at_end)

    def _run_due_chores(self) -> None:
        due = dict.fromkeys((chore.name for chore in self._chores), 0.0)
        while not self._ending.wait(LOOK_SECONDS):
            for chore in self._chores:
                if time.monotonic() < due[chore.name] or self._ending.is_set():
                    continue
                due[chore.name] = time.monotonic() + chore.every_seconds
                try:
                    chore.run()
                except Exception as error:  # the worker's edge: the chore runs again later
                    log.warning("chore_failed", chore=chore.name, exc_info=error)
                    instruments.CHORES_FAILED.labels(chore.name).inc()
                else:
                    instruments.CHORE_DONE.labels(chore.name).set_to_current_time()


def _end(name: str, at_end: Callable[[], object]) -> None:
    try:
        at_end()
    except Exception as error:  # the worker's edge: it ends all the same
        log.warning("chore_not_ended", chore=name, exc_info=error)
