"""Child processes of the HTTP server, for requests that decode uploaded bytes: checks, calibrations, pictures.

A pool like the worker's (child_pool.py) behind a fair queue (fair_line.py): while all children are busy, a request
waits a little; studies take turns, and a caller has one child at a time. The queue is short: a request that finds it
full is told to come back later.
"""

import contextlib
import threading
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import structlog

from app.children.child_pool import ChildPool, ChildPoolClosedError, ChildRequest, ChildResult, ChildStartError
from app.children.fair_line import FairLine, LineFullError
from app.core.errors import TadaError, UnavailableError
from app.core.settings import Settings

log = structlog.get_logger()

TASKS = "app.estimates.child_tasks:TASKS"
WAITING_A_CHILD = 10  # with two children sixteen uploads of one study may wait, and threads are left for others
WAIT_SECONDS = 6.0
MAX_UNDECODABLE = 100_000  # remembered photographs: some 10 MB
PATIENCE = 3.0  # times a task's limit of processor time, by the clock: longer than phones wait for an answer
RETRY_AFTER_SECONDS = 3
WARM_UP_AFTER_SECONDS = 3.0  # once the server answers; a start takes a second of one core


@dataclass(frozen=True, slots=True)
class Whose:
    """For whom a child works: studies take turns, and each caller has at most one child."""

    study_id: uuid.UUID | None
    caller_id: uuid.UUID | None


class PhotographError(TadaError):
    """A child crashed or was killed while it decoded the photograph."""

    code = "photograph_not_decoded"
    status = 422


class ApiChildren:
    """At most settings.api_children children; one object per process of the server."""

    def __init__(self, settings: Settings, *, tasks: str = TASKS, wait_seconds: float = WAIT_SECONDS) -> None:
        self._pool = ChildPool(settings, tasks, children=settings.api_children)
        most_waiting = settings.api_children * WAITING_A_CHILD
        self._line = FairLine(settings.api_children, most_waiting=most_waiting, wait_seconds=wait_seconds)
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
        decoding takes long (decoding_cost.py), so one child stays free for others.

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
                    ChildRequest(task, arguments, is_costly), lambda _: None, seconds=seconds, patience=PATIENCE
                )
            except (ChildPoolClosedError, ChildStartError) as error:
                raise _busy() from error
        if ended.outcome == "ok":
            return ended.result
        log.error("api_child_ended_badly", task=task, outcome=ended.outcome, message=_loggable_message(ended))
        if ended.outcome in ("stalled", "killed") or ended.errno is not None:  # as http/problems.py answers an OSError
            raise _busy()
        if ended.outcome == "raised":
            raise TadaError("The server made a mistake while it decoded the photograph; its log has the details.")
        if photograph_sha256 is not None and len(self._undecodable) < MAX_UNDECODABLE:
            self._undecodable.add(photograph_sha256)
        raise _not_decoded()

    def close(self) -> None:
        """Kill all children."""
        self._warming.cancel()
        self._pool.close()

    @contextlib.contextmanager
    def _admitted(self, whose: Whose, *, is_costly: bool) -> Iterator[None]:
        with contextlib.ExitStack() as place:
            try:
                place.enter_context(self._line.place(whose.study_id, whose.caller_id, is_costly=is_costly))
            except LineFullError:
                raise _busy() from None
            yield

    def _warm_up(self) -> None:
        try:
            with self._line.place(None, None):
                self._pool.warm_up()
        except (ChildPoolClosedError, LineFullError):  # the server is shutting down, or children are already running
            pass
        except ChildStartError:
            log.warning("api_child_not_started", exc_info=True)


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
