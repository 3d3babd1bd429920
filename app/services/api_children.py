"""Child processes of the HTTP server, for what must decode uploaded bytes at once: checks, calibrations, pictures.

The worker's pool (jobs/child_pool.py) with a door before it: whoever comes while all children are busy waits a little,
and only so many may wait, so that a crowd gets an answer that says "later" instead of a queue without end.
"""

import contextlib
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import structlog

from app.errors import TadaError, UnavailableError
from app.jobs.child_pool import ChildPool, ChildPoolClosedError, ChildRequest, ChildResult, ChildStartError
from app.settings import Settings

log = structlog.get_logger()

TASKS = "app.services.child_tasks:TASKS"
WAITING_A_CHILD = 8  # more would wait longer than a phone does
WAIT_SECONDS = 6.0
PATIENCE = 3.0  # times a task's limit of processor time, by the clock: longer than phones wait for an answer
RETRY_AFTER_SECONDS = 3
WARM_UP_AFTER_SECONDS = 3.0  # once the server answers; a start takes a second of one core


class PhotographError(TadaError):
    """What a child died of, or was killed for: these bytes, most likely."""

    code = "photograph_not_decoded"
    status = 422


class ApiChildren:
    """At most settings.api_children at work; one a process of the server."""

    def __init__(self, settings: Settings, *, tasks: str = TASKS, wait_seconds: float = WAIT_SECONDS) -> None:
        self._pool = ChildPool(settings, tasks, children=settings.api_children)
        self._wait_seconds = wait_seconds
        self._places = threading.BoundedSemaphore(settings.api_children * (1 + WAITING_A_CHILD))
        self._free = threading.BoundedSemaphore(settings.api_children)
        self._warming = threading.Timer(WARM_UP_AFTER_SECONDS, self._warm_up)
        self._warming.daemon = True

    def start_soon(self) -> None:
        """Have a child ready in a few seconds, without keeping the server's start waiting."""
        self._warming.start()

    def run(self, task: str, arguments: Mapping[str, Any], *, seconds: float) -> Mapping[str, Any]:
        """Perform a task of child_tasks.py. seconds: of processor time, at most; then its child ends.

        Raises UnavailableError (`server_busy`: also where the machine, not the photograph, took too long),
        PhotographError (it crashed, wanted too much memory or processor time), TadaError (`internal_error`: a mistake
        of ours).
        """
        with self._admitted():
            try:
                ended = self._pool.run(
                    ChildRequest(task, arguments), lambda _: None, seconds=seconds, patience=PATIENCE
                )
            except (ChildPoolClosedError, ChildStartError) as error:
                raise _busy() from error
        if ended.outcome == "ok":
            return ended.result
        log.error("api_child_ended_badly", task=task, outcome=ended.outcome, message=_words(ended))
        if ended.outcome in ("stalled", "killed"):
            raise _busy()
        if ended.outcome == "raised":
            raise TadaError("The server made a mistake while it looked at the photograph; it is in its log.")
        raise PhotographError("The photograph cannot be decoded here: take another one, or use JPEG.")

    def close(self) -> None:
        """Kill all children."""
        self._warming.cancel()
        self._pool.close()

    @contextlib.contextmanager
    def _admitted(self) -> Iterator[None]:
        if not self._places.acquire(blocking=False):
            raise _busy()
        try:
            if not self._free.acquire(timeout=self._wait_seconds):
                raise _busy()
            try:
                yield
            finally:
                self._free.release()
        finally:
            self._places.release()

    def _warm_up(self) -> None:
        if not self._free.acquire(blocking=False):
            return  # one is at work already
        try:
            self._pool.warm_up()
        except ChildPoolClosedError:
            pass
        except ChildStartError:
            log.warning("api_child_not_started", exc_info=True)
        finally:
            self._free.release()


def _words(ended: ChildResult) -> str:
    """The child's words, unless a library wrote them, which may quote what was in the photograph."""
    return ended.message.partition(":")[0]


def _busy() -> UnavailableError:
    return UnavailableError(
        "The server looks at other photographs just now: try again in a few seconds.",
        code="server_busy",
        retry_after_seconds=RETRY_AFTER_SECONDS,
    )
