"""Structured logs on standard error: JSON for machines, or lines for people. No personal data: ids and codes only.

Beside its event, a line has `request_id` during a request, `job_id` during a job, and the facts bound on the way
(`bind_log_context(meal_id=...)`), which are also in the line that ends the request or job. So a search for a meal's id
finds all its lines, from upload to record and webhook.
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

from app.core.log_causes import OneTracebackPerCause
from app.core.settings import Settings

QUIET = (
    "python_multipart",
    "uvicorn.access",
    "alembic",
    "PIL",
    "httpx2",
)  # they log every step or request
UUID_PATTERN = re.compile(
    r"[0-9a-f]{8}(-?)[0-9a-f]{4}\1[0-9a-f]{4}\1[0-9a-f]{4}\1[0-9a-f]{12}", re.IGNORECASE
)
NO_ROUTE = "(no route)"

# one mapping per request or job: its threads copy the context and share the mapping
_facts: contextvars.ContextVar[dict[str, object] | None] = contextvars.ContextVar(
    "facts", default=None
)


def route_name(scope: Mapping[str, object]) -> str:
    """Return the name of the request's target in logs: its route's pattern, such as /v1/meals/{meal_id}.

    Never the requested path: paths contain participants' codes and ids made by phones, and a path without a route may
    contain anything.
    """
    return getattr(scope.get("route"), "path", NO_ROUTE)


def request_id_of(sent: str | None) -> str:
    """Return a request's id: the one sent by a phone or proxy if it is a UUID, with or without dashes; else a new one.

    Only a UUID is accepted: the caller's value appears in the logs, and a UUID cannot contain a name or a token.
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
