"""Child processes of the HTTP server, for requests that decode uploaded bytes: checks, calibrations, pictures.

A pool like the worker's (child_pool.py): while all children are busy, a request waits a little. A caller has one child
at a time, and photographs that take long to decode never have all children, so that ordinary ones do not wait for
them. Few requests may wait, of one study and of one caller fewer still; one too many is told to come back later.
"""

import contextlib
import threading
import time
import uuid
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import structlog

from app.children.child_pool import (
    ChildPool,
    ChildPoolClosedError,
    ChildRequest,
    ChildResult,
    ChildStartError,
)
from app.core.errors import TadaError, UnavailableError
from app.core.settings import Settings
from app.photos.inspect import COSTLY_PIXELS

log = structlog.get_logger()

TASKS = "app.meals.estimate.child_tasks:TASKS"
# with two children sixteen uploads of one study may wait, and threads are left for others
WAITING_A_CHILD = 10
WAIT_SECONDS = 6.0
INSPECT_SECONDS = 5.0  # of processor time; reading the structure of 30 MB takes a tenth
MAX_UNDECODABLE = 100_000  # remembered photographs: some 10 MB
PATIENCE = 3.0  # times a task's limit of processor time, by the clock: longer than phones wait for an answer
RETRY_AFTER_SECONDS = 3
WARM_UP_AFTER_SECONDS = 3.0  # once the server answers; a start takes a second of one core


@dataclass(frozen=True, slots=True)
class Whose:
    """For whom a child works."""

    study_id: uuid.UUID | None
    caller_id: uuid.UUID | None


class PhotographError(TadaError):
    """A child crashed or was killed while it decoded the photograph."""

    code = "photograph_not_decoded"
    status = 422


@dataclass(frozen=True, slots=True)
class InspectedPhotos:
    """sizes: width and height, px, upright, of the photographs that are whole."""

    sizes: Sequence[tuple[int, int]]
    is_costly: bool


class _SemaphorePerKey:
    """A semaphore for each key that somebody holds or waits for."""

    def __init__(self, value: int) -> None:
        self._value = value
        self._lock = threading.Lock()
        self._semaphores: WeakValueDictionary[Hashable, threading.Semaphore] = WeakValueDictionary()

    def of(self, key: Hashable) -> threading.Semaphore:
        """Return the key's."""
        with self._lock:
            return self._semaphores.setdefault(key, threading.Semaphore(self._value))


class ApiChildren:
    """At most settings.api_children children; one object per process of the server."""

    def __init__(
        self, settings: Settings, *, tasks: str = TASKS, wait_seconds: float = WAIT_SECONDS
    ) -> None:
        self._pool = ChildPool(settings, tasks, children=settings.api_children)
        self._wait_seconds = wait_seconds
        room = settings.api_children * (1 + WAITING_A_CHILD)
        self._room = threading.Semaphore(room)
        self._room_of_study = _SemaphorePerKey(room - room // 4)
        self._room_of_caller = _SemaphorePerKey(room - room // 2)
        self._child_of_caller = _SemaphorePerKey(1)
        self._costly = threading.Semaphore(max(1, settings.api_children - 1))
        self._children = threading.Semaphore(settings.api_children)
        self._undecodable: set[str | None] = set()
        self._warming = threading.Timer(WARM_UP_AFTER_SECONDS, self._warm_up)
        self._warming.daemon = True

    def start_soon(self) -> None:
        """Start a child in a few seconds, without delaying the server's start."""
        self._warming.start()

    def run(
        self,
        task: str,
        arguments: Mapping[str, object],
        *,
        seconds: float,
        whose: Whose,
        photograph_sha256: str | None = None,
        is_costly: bool = False,
    ) -> Mapping[str, Any]:
        """Perform a task of child_tasks.py. seconds: limit of processor time, after which the child is killed.

        photograph_sha256: of the decoded photograph; one that broke a child before is refused at once. is_costly:
        decoding takes long, so one child stays free for others.

        Raises UnavailableError (`server_busy`: also if the machine, not the photograph, was too slow, or if a system
        call of the child failed, for example on a full disk or for a file that was removed as abandoned),
        PhotographError (the child crashed or needed too much memory or processor time), TadaError (`internal_error`: a
        bug).
        """
        if photograph_sha256 in self._undecodable:
            raise _not_decoded()
        with self._admitted(whose, is_costly=is_costly):
            try:
                ended = self._pool.run(
                    ChildRequest(task, arguments, is_costly),
                    lambda _: None,
                    seconds=seconds,
                    patience=PATIENCE,
                )
            except (ChildPoolClosedError, ChildStartError) as error:
                raise _busy() from error
        if ended.outcome == "ok":
            return ended.result
        log.error(
            "api_child_ended_badly",
            task=task,
            outcome=ended.outcome,
            message=_loggable_message(ended),
        )
        # as http/problems.py answers an OSError
        if ended.outcome in ("stalled", "killed") or ended.errno is not None:
            raise _busy()
        if ended.outcome == "raised":
            raise TadaError(
                "The server made a mistake while it decoded the photograph; its log has the details."
            )
        if photograph_sha256 is not None and len(self._undecodable) < MAX_UNDECODABLE:
            self._undecodable.add(photograph_sha256)
        raise _not_decoded()

    def inspect(self, paths: Sequence[Path], whose: Whose) -> InspectedPhotos:
        """Inspect photographs that are decoded together. One that is damaged counts as costly. Raises as `run`."""
        request = {"photos": [str(path) for path in paths]}
        result = self.run("inspect", request, seconds=INSPECT_SECONDS, whose=whose)
        sizes = [(width, height) for width, height in result["sizes"]]
        is_damaged = len(sizes) < len(paths)
        return InspectedPhotos(sizes, is_damaged or result["decoding_pixels"] > COSTLY_PIXELS)

    def close(self) -> None:
        """Kill all children."""
        self._warming.cancel()
        self._pool.close()

    @contextlib.contextmanager
    def _admitted(self, whose: Whose, *, is_costly: bool) -> Iterator[None]:
        """Hold a child's place. Raises UnavailableError."""
        room = [
            self._room_of_caller.of(whose.caller_id),
            self._room_of_study.of(whose.study_id),
            self._room,
        ]
        turns = [
            self._child_of_caller.of(whose.caller_id),
            *([self._costly] if is_costly else []),
            self._children,
        ]
        deadline = time.monotonic() + self._wait_seconds
        with contextlib.ExitStack() as held:
            for semaphore in room:
                _hold(held, semaphore, 0.0)
            for semaphore in turns:
                _hold(held, semaphore, deadline - time.monotonic())
            yield

    def _warm_up(self) -> None:
        try:
            self._pool.warm_up()
        except ChildPoolClosedError:  # the server is shutting down
            pass
        except ChildStartError:
            log.warning("api_child_not_started", exc_info=True)


def _hold(held: contextlib.ExitStack, semaphore: threading.Semaphore, seconds: float) -> None:
    """Wait so long for the semaphore, and release it with the others. Raises UnavailableError."""
    if not semaphore.acquire(timeout=max(seconds, 0.0)):
        raise _busy()
    held.callback(semaphore.release)


def _loggable_message(ended: ChildResult) -> str:
    """Drop the text after the error's name: a library may quote the photograph's content in it."""
    return ended.message.partition(":")[0]


def _not_decoded() -> PhotographError:
    return PhotographError("The photograph cannot be decoded here: take another one, or use JPEG.")


def _busy() -> UnavailableError:
    return UnavailableError(
        "The server looks at other photographs just now: try again in a few seconds.",
        code="server_busy",
        retry_after_seconds=RETRY_AFTER_SECONDS,
    )
