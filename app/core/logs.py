"""Structured logs on standard error: JSON for machines, or lines for a person. No personal data: ids and codes only.

What a line tells beside its event: `request_id` in all of a request, `job_id` in all of a job, and the facts that the
code learns on the way (`tell(meal_id=...)`), which also stand in the line that ends the request or the job. One search
for a meal's id finds its whole way, from upload to record and webhook.
"""

import contextlib
import contextvars
import logging
import re
import sys
import uuid
from collections.abc import Iterator, Mapping

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

from app.core.log_causes import OneTracebackACause
from app.core.settings import Settings

QUIET = ("python_multipart", "uvicorn.access", "alembic", "PIL", "httpx2")  # a line a step or a request each
UUID_PATTERN = re.compile(r"[0-9a-f]{8}(-?)[0-9a-f]{4}\1[0-9a-f]{4}\1[0-9a-f]{4}\1[0-9a-f]{12}", re.IGNORECASE)
NO_ROUTE = "(no route)"

# one mapping for a whole request or job: threads that work for it copy the context, and share what is in it
_facts: contextvars.ContextVar[dict[str, object] | None] = contextvars.ContextVar("facts", default=None)


def route_name(scope: Mapping[str, object]) -> str:
    """What logs call the target of a request of this ASGI scope: its route's pattern, such as /v1/meals/{meal_id}.

    Never the path that was sent: paths hold participants' codes and the ids that phones make, and a path that fits no
    route may hold anything.
    """
    return getattr(scope.get("route"), "path", NO_ROUTE)


def request_id_of(sent: str | None) -> str:
    """The id of a request: the one that a phone or a proxy sent, if it is a UUID (dashes or not), else a new one.

    A UUID and nothing else: what a caller writes there stands in the logs, and a UUID can hold no name and no token.
    """
    if sent is not None and UUID_PATTERN.fullmatch(sent):
        return sent.replace("-", "").lower()
    return uuid.uuid4().hex


@contextlib.contextmanager
def telling(**facts: object) -> Iterator[dict[str, object]]:
    """All lines until the end carry these facts, and those that `tell` adds. Ids and codes only."""
    mine = dict(facts)
    token = _facts.set(mine)
    try:
        yield mine
    finally:
        _facts.reset(token)


def tell(**facts: object) -> None:
    """Add facts to all further lines of this request or job; outside of one, nothing."""
    mine = _facts.get()
    if mine is not None:
        mine.update(facts)


def _add_facts(_: WrappedLogger, __: str, line: EventDict) -> EventDict:
    """A processor: what was told; the line's own words win."""
    for name, value in (_facts.get() or {}).items():
        line.setdefault(name, value)
    return line


class _Stderr:
    """Standard error that loses a line rather than the request which it tells of: the log's disk may be full."""

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            sys.stderr.flush()


def configure_logging(settings: Settings) -> None:
    """Set up structlog and the standard library's logging to write the same way."""
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
        OneTracebackACause(),
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
    handler.setFormatter(structlog.stdlib.ProcessorFormatter(processor=renderer, foreign_pre_chain=shared))
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(level)
    for name in QUIET:
        logging.getLogger(name).setLevel(max(level, logging.WARNING))
