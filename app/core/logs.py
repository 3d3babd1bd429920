"""Structured logs on standard error: JSON for machines, or lines for people.

No personal data: ids and codes only.

Beside its event, a line has `request_id` during a request, `job_id` during a job, and the facts
bound on the way (`bind_log_context(meal_id=...)`), which are also in the line that ends the request
or job. So a search for a meal's id finds all its lines, from upload to record and webhook.
"""

import contextlib
import contextvars
import logging
import re
import sys
import threading
import time
import traceback
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import TracebackType

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

from app.core.settings import Settings

WINDOW_SECONDS = 60.0
MAX_LINES = 10  # per window, only for outages: lines of other causes may differ in what they report
# of database drivers, beside all OSErrors
OUTAGE_ERRORS = frozenset({"OperationalError", "InterfaceError"})
MAX_CAUSES = 200

Cause = tuple[str, str, int]  # the exception's type, and where it was raised
# they log every step or request
QUIET = ("python_multipart", "uvicorn.access", "alembic", "PIL", "httpx2")
UUID_PATTERN = re.compile(
    r"[0-9a-f]{8}(-?)[0-9a-f]{4}\1[0-9a-f]{4}\1[0-9a-f]{4}\1[0-9a-f]{12}", re.IGNORECASE
)
NO_ROUTE = "(no route)"

# one mapping per request or job: its threads copy the context and share the mapping
_facts: contextvars.ContextVar[dict[str, object] | None] = contextvars.ContextVar(
    "facts", default=None
)


@dataclass(slots=True)
class _Window:
    since: float
    lines: int = 0
    left_out: int = 0


class OneTracebackPerCause:
    """A structlog processor: one traceback per cause and minute. clock: monotonic, s.

    During a database outage each request and heartbeat would log its own. The first line of a cause
    has the traceback, the next ones only name the cause. For outages of a database, disk or
    network, lines beyond ten per minute are dropped and counted in the next minute's first line.
    """

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


def route_name(scope: Mapping[str, object]) -> str:
    """Return the name of the request's target in logs: its route's pattern, such as /v1/meals/{meal_id}.

    Never the requested path: paths contain participants' codes and ids made by phones, and a path
    without a route may contain anything.
    """
    return getattr(scope.get("route"), "path", NO_ROUTE)


def request_id_of(sent: str | None) -> str:
    """Return a request's id: the one sent by a phone or proxy if it is a UUID, with or without dashes; else a new one.

    Only a UUID is accepted: the caller's value appears in the logs, and a UUID cannot contain a
    name or a token.
    """
    if sent is not None and UUID_PATTERN.fullmatch(sent):
        return sent.replace("-", "").lower()
    return uuid.uuid4().hex


@contextlib.contextmanager
def log_context(**facts: object) -> Iterator[dict[str, object]]:
    """Add these facts, and those of `bind_log_context`, to all lines inside. Ids and codes only."""
    context_facts = dict(facts)
    token = _facts.set(context_facts)
    try:
        yield context_facts
    finally:
        _facts.reset(token)


def bind_log_context(**facts: object) -> None:
    """Add facts to all further lines of this request or job; outside of one, do nothing."""
    context_facts = _facts.get()
    if context_facts is not None:
        context_facts.update(facts)


def _add_facts(_: WrappedLogger, __: str, line: EventDict) -> EventDict:
    """Add the facts of the context; the line's own fields take precedence."""
    for name, value in (_facts.get() or {}).items():
        line.setdefault(name, value)
    return line


class _Stderr:
    """Standard error that drops lines it cannot write: a full log disk must not fail requests."""

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            sys.stderr.flush()


def configure_logging(settings: Settings) -> None:
    """Set up structlog and the standard library's logging to write the same format."""
    renderer = (
        structlog.processors.JSONRenderer()
        if settings.log_format == "json"
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())
    )
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        _add_facts,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.StackInfoRenderer(),
        OneTracebackPerCause(),
        structlog.processors.format_exc_info,
    ]
    level = logging.getLevelNamesMapping()[settings.log_level]
    structlog.configure(
        processors=[*shared, renderer],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(_Stderr()),  # type: ignore[arg-type]  # it writes and flushes
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(processor=renderer, foreign_pre_chain=shared)
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(level)
    for name in QUIET:
        logging.getLogger(name).setLevel(max(level, logging.WARNING))
