"""One log line a request, with an id that the answer carries too (`X-Request-Id`), and its figures for /metrics.

No path, query, token or body is logged: the route's pattern, ids of ours and codes. It is also
where a mistake of ours ends: logged whole, told as a problem document without any of it.
"""

import time
from urllib.parse import parse_qs

import structlog
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import TadaError
from app.core.logs import log_context, request_id_of, route_name
from app.http.problems import render_problem
from app.metrics import instruments

log = structlog.get_logger()

QUIET_PATHS = frozenset({"/healthz", "/readyz", "/metrics"})
# what brings a meal or a photograph of one; each refusal of these is a meal that is still on a
# phone only
UPLOAD_ROUTES = frozenset(
    {
        ("POST", "/v1/meals"),
        ("PUT", "/v1/meals/{meal_id}"),
        ("PUT", "/v1/meals/{meal_id}/images/{slot}"),
        ("PUT", "/v1/meals/{meal_id}/after"),
    }
)
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
CLIENT_GONE = (0, 499)  # the caller left before an answer began


class RequestLog:
    """ASGI middleware: binds the request's id to all that is logged meanwhile."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Time the request, log its end and count it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = request_id_of(Headers(scope=scope).get("x-request-id"))
        seen = _Seen()

        async def counted_receive() -> Message:
            message = await receive()
            seen.note_received(message)
            return message

        async def stamped_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                seen.note_answer(message["status"])
                message["headers"] = [
                    *message.get("headers", ()),
                    (b"x-request-id", request_id.encode()),
                ]
            await send(message)

        instruments.IN_FLIGHT.inc()
        with structlog.contextvars.bound_contextvars(request_id=request_id), log_context() as facts:
            try:
                await self._app(scope, counted_receive, stamped_send)
            except Exception:
                log.exception("request_crashed", route=route_name(scope))
                if seen.status:  # the answer has begun: all that is left is to cut it
                    raise
                crash = TadaError(
                    "Something went wrong on the server. It is logged; nothing was kept."
                )
                await render_problem(crash)(scope, counted_receive, stamped_send)
            finally:
                instruments.IN_FLIGHT.dec()
                code = facts.get("code")
                seen.count(scope, str(code) if code is not None else None)
                if scope["path"] not in QUIET_PATHS:
                    log.info(
                        "request",
                        method=scope["method"],
                        route=route_name(scope),
                        status=seen.status,
                        milliseconds=round(1000 * (time.perf_counter() - seen.started), 1),
                        bytes=seen.received_bytes,
                    )


class _Seen:
    """What passed by of one request. Times: seconds of perf_counter."""

    def __init__(self) -> None:
        self.started = self._received = time.perf_counter()
        self._answered: float | None = None
        self.status = 0
        self.received_bytes = 0

    def note_received(self, message: Message) -> None:
        if self._answered is not None or message["type"] != "http.request":
            return
        body = len(message.get("body", b""))
        self.received_bytes += body
        if body:
            self._received = time.perf_counter()

    def note_answer(self, status: int) -> None:
        self.status = status
        self._answered = time.perf_counter()

    def count(self, scope: Scope, code: str | None) -> None:
        """Into the figures. code: of the problem that was answered."""
        # anybody may send any word as the method, and each would be a series for ever
        method = scope["method"] if scope["method"] in METHODS else "other"
        route = route_name(scope)
        if _waits(scope):
            route += " (waits)"
        elif self._answered is not None:
            instruments.ANSWERS.labels(method, route).observe(self._answered - self._received)
        status = f"{self.status // 100}xx" if self.status else "none"
        instruments.REQUESTS.labels(method, route, status).observe(
            time.perf_counter() - self.started
        )
        instruments.RECEIVED.inc(self.received_bytes)
        if code is not None:
            instruments.PROBLEMS.labels(code).inc()
        if (method, route) in UPLOAD_ROUTES:
            instruments.UPLOADS.labels(self._upload_outcome(code)).inc()

    def _upload_outcome(self, code: str | None) -> str:
        if code is not None:
            return code
        if self.status in CLIENT_GONE:
            return "cut"
        return "kept" if self.status == 202 else "repeated"


def _waits(scope: Scope) -> bool:
    """Whether the caller asked to be kept waiting: `?wait=25`."""
    query: bytes = scope["query_string"]
    return b"wait=" in query and parse_qs(query.decode("latin-1")).get("wait", ["0"])[-1] not in (
        "0",
        "0.0",
    )
