"""Several processes of one server, forked from one that watches over them and has neither threads nor an event loop.

The first child decides whether the server can start: if it ends before it is ready, it has explained why, and all ends
with its status. The others follow once it is ready. Whichever ends later is replaced, after a pause that grows while
it does not stay.
"""

import contextlib
import gc
import os
import select
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import structlog

from app.core.process_life import die_with_parent
from app.jobs.supervisor import FIRST_WAIT_SECONDS, LONGEST_WAIT_SECONDS, STEADY_SECONDS

log = structlog.get_logger()

WORKER = -1  # the place of the process that keeps the embedded worker
HANDLED = (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD)
READY = b"\0"  # signals write their number


@dataclass(frozen=True, slots=True)
class Forked:
    """A child's place (0, 1 ..., or WORKER) and its way to say that it is ready."""

    place: int
    pipe: int

    def announce(self) -> None:
        """Tell the parent that this process serves."""
        os.write(self.pipe, READY)


@dataclass(slots=True)
class _Place:
    number: int
    pid: int | None = None
    started_at: float = 0.0
    due_at: float = 0.0
    pause_seconds: float = FIRST_WAIT_SECONDS


class Prefork:
    """The processes of a server. on_ready: called once. on_end: with the place and the id of one that has ended."""

    def __init__(
        self,
        processes: int,
        *,
        with_worker: bool,
        on_ready: Callable[[], None],
        on_end: Callable[[int, int], None],
        on_stop: Callable[[], None],
    ) -> None:
        self._servers = [_Place(number) for number in range(processes)]
        self._worker = [_Place(WORKER)] if with_worker else []
        self._on_ready, self._on_end, self._on_stop = on_ready, on_end, on_stop
        self._reader, self._writer = os.pipe()
        self._signals: list[int] = []
        self._is_ready = False
        self._is_stopping = False
        self._status = 0

    def run(self) -> Forked | int:
        """Return in each child what it is; in the parent, once all have ended, the exit status."""
        os.set_blocking(self._writer, False)
        signal.set_wakeup_fd(self._writer)
        for number in HANDLED:
            signal.signal(number, lambda number, _: self._signals.append(number))
        gc.freeze()  # a collection in a child would otherwise write to, and so copy, all shared pages
        while True:
            for place in self._due():
                forked = self._fork(place)
                if forked is not None:
                    return forked
            if not self._wait():
                return self._status

    def _due(self) -> list[_Place]:
        """Return the places in which a process is to be started now."""
        wanted = [*self._servers, *self._worker] if self._is_ready else self._servers[:1]
        now = time.monotonic()
        return [place for place in wanted if place.pid is None and place.due_at <= now and not self._is_stopping]

    def _fork(self, place: _Place) -> Forked | None:
        parent = os.getpid()
        with _blocked_signals():
            place.started_at = time.monotonic()
            pid = os.fork()
            if pid:
                place.pid = pid
                return None
            signal.set_wakeup_fd(-1)
            for number in HANDLED:
                signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
            os.setpgid(0, 0)  # a terminal's Ctrl-C reaches the parent alone, which passes it on once
            os.close(self._reader)
        die_with_parent(parent)
        return Forked(place.number, self._writer)

    def _wait(self) -> bool:
        """Wait until something happens, and see to it. Return whether any process is left or to be started."""
        dues = [place.due_at for place in (*self._servers, *self._worker) if place.pid is None and self._is_ready]
        seconds = max(min(dues) - time.monotonic(), 0.0) if dues and not self._is_stopping else None
        if select.select([self._reader], [], [], seconds)[0] and READY in os.read(self._reader, 4096):
            self._note_ready()
        for place in (*self._servers, *self._worker):
            self._reap(place)
        while self._signals:
            self._pass_on(self._signals.pop(0))
        if not self._is_stopping:
            return True
        if not any(place.pid for place in self._servers):  # the worker goes last, as requests may wait for it
            _send(self._worker, signal.SIGTERM)
        return any(place.pid for place in (*self._servers, *self._worker))

    def _note_ready(self) -> None:
        if not self._is_ready:
            self._is_ready = True
            self._on_ready()

    def _reap(self, place: _Place) -> None:
        if place.pid is None:
            return
        pid, wait_status = os.waitpid(place.pid, os.WNOHANG)
        if pid == 0:
            return
        place.pid = None
        self._on_end(place.number, pid)
        status = os.waitstatus_to_exitcode(wait_status)
        if self._is_stopping:
            return
        if not self._is_ready:
            self._status = status if status > 0 else 1
            self._is_stopping = True
            if status < 0:
                log.error("server_process_ended", place=place.number, status=status)
            return
        lived = time.monotonic() - place.started_at
        log.error("server_process_ended", place=place.number, status=status, lived_seconds=round(lived, 1))
        if lived > STEADY_SECONDS:
            place.pause_seconds = FIRST_WAIT_SECONDS
        place.due_at = time.monotonic() + place.pause_seconds
        place.pause_seconds = min(2 * place.pause_seconds, LONGEST_WAIT_SECONDS)

    def _pass_on(self, number: int) -> None:
        """SIGTERM or SIGINT: all end once their requests have. A second SIGINT: now."""
        if number == signal.SIGCHLD:
            return
        if not self._is_stopping:
            self._is_stopping = True
            self._on_stop()
            _send(self._servers, signal.SIGTERM)
        elif number == signal.SIGINT:
            _send(self._servers, signal.SIGINT)


def _send(places: list[_Place], number: signal.Signals) -> None:
    for place in places:
        if place.pid is not None:
            os.kill(place.pid, number)


@contextlib.contextmanager
def _blocked_signals() -> Iterator[None]:
    """Signals that come meanwhile are delivered afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, HANDLED)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
