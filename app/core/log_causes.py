"""Log one traceback per cause and minute: during a database outage each request and heartbeat would log its own.

A structlog processor. The first line of a cause has the traceback, the next ones only name the cause. For outages of a
database, disk or network, lines beyond ten per minute are dropped and counted in the next minute's first line.
"""

import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import structlog
from structlog.typing import EventDict, WrappedLogger

WINDOW_SECONDS = 60.0
MAX_LINES = 10  # per window, only for outages: lines of other causes may differ in what they report
OUTAGE_ERRORS = frozenset(
    {"OperationalError", "InterfaceError"}
)  # of database drivers, beside all OSErrors
MAX_CAUSES = 200

Cause = tuple[str, str, int]  # the exception's type, and where it was raised


@dataclass(slots=True)
class _Window:
    since: float
    lines: int = 0
    left_out: int = 0


class OneTracebackPerCause:
    """Remembers the causes logged in this process. clock: monotonic, s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._windows: dict[Cause, _Window] = {}
        self._lock = threading.Lock()

    def __call__(self, _: WrappedLogger, __: str, line: EventDict) -> EventDict:
        """Keep the traceback, replace it by the cause's name, or drop the line."""
        logged = _exception_of(line.get("exc_info"))
        if logged is None:
            return line
        error = _root_of(logged)
        cause = (type(error).__name__, *_innermost(error.__traceback__))
        with self._lock:
            now = self._clock()
            window = self._windows.get(cause)
            if window is None or now - window.since > WINDOW_SECONDS:
                left_out = window.left_out if window is not None else 0
                self._windows.pop(cause, None)
                self._windows[cause] = _Window(now, 1)
                if len(self._windows) > MAX_CAUSES:
                    del self._windows[next(iter(self._windows))]
                if left_out:
                    line["lines_left_out"] = left_out
                return line
            window.lines += 1
            if window.lines > MAX_LINES and (
                isinstance(error, OSError) or cause[0] in OUTAGE_ERRORS
            ):
                window.left_out += 1
                raise structlog.DropEvent
        del line["exc_info"]
        line["cause"] = f"{cause[0]}, logged within the last minute"
        return line


def _exception_of(exc_info: object) -> BaseException | None:
    match exc_info:
        case BaseException():
            return exc_info
        case (_, BaseException() as error, _):
            return error
        case None | False:
            return None
    return sys.exc_info()[1]


def _root_of(error: BaseException) -> BaseException:
    """Return the first exception of the chain."""
    while (
        cause := error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    ) is not None:
        error = cause
    return error


def _innermost(frames: TracebackType | None) -> tuple[str, int]:
    last = next(iter(traceback.extract_tb(frames)[-1:]), None)
    return (last.filename, last.lineno or 0) if last is not None else ("", 0)
