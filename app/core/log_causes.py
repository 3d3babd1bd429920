"""One traceback a cause and minute: while a database is away, each request and each heartbeat would bring its own.

A processor of structlog. The first line of a cause has the traceback, the next name the cause alone. Of a database, a
disk or a network that is away ten lines a minute are enough: more are left out, and counted in the next minute's first.
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
LINES = 10  # in a window, of a cause that is nobody's but the machine's: other lines may name what is wrong with whom
AWAY = frozenset({"OperationalError", "InterfaceError"})  # of database drivers, beside all of OSError
MAX_CAUSES = 200

Cause = tuple[str, str, int]  # the exception's type, and where it was raised


@dataclass(slots=True)
class _Seen:
    since: float
    lines: int = 0
    left_out: int = 0


class OneTracebackACause:
    """Keeps what it has seen in this process. clock: monotonic, s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen: dict[Cause, _Seen] = {}
        self._lock = threading.Lock()

    def __call__(self, _: WrappedLogger, __: str, line: EventDict) -> EventDict:
        """Leave the traceback in, replace it by a name, or drop the line."""
        told = _exception_of(line.get("exc_info"))
        if told is None:
            return line
        error = _root_of(told)
        cause = (type(error).__name__, *_innermost(error.__traceback__))
        with self._lock:
            now = self._clock()
            seen = self._seen.get(cause)
            if seen is None or now - seen.since > WINDOW_SECONDS:
                left_out = seen.left_out if seen is not None else 0
                self._seen.pop(cause, None)
                self._seen[cause] = _Seen(now, 1)
                if len(self._seen) > MAX_CAUSES:
                    del self._seen[next(iter(self._seen))]
                if left_out:
                    line["lines_left_out"] = left_out
                return line
            seen.lines += 1
            if seen.lines > LINES and (isinstance(error, OSError) or cause[0] in AWAY):
                seen.left_out += 1
                raise structlog.DropEvent
        del line["exc_info"]
        line["cause"] = f"{cause[0]}, told within the last minute"
        return line


def _exception_of(told: object) -> BaseException | None:
    match told:
        case BaseException():
            return told
        case (_, BaseException() as error, _):
            return error
        case None | False:
            return None
    return sys.exc_info()[1]


def _root_of(error: BaseException) -> BaseException:
    """The exception that it began with."""
    while (before := error.__cause__ or (None if error.__suppress_context__ else error.__context__)) is not None:
        error = before
    return error


def _innermost(frames: TracebackType | None) -> tuple[str, int]:
    last = next(iter(traceback.extract_tb(frames)[-1:]), None)
    return (last.filename, last.lineno or 0) if last is not None else ("", 0)
