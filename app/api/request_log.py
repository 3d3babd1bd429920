"""One log line a request, with an id that the answer carries too (`X-Request-Id`). No path, query, token or body.

It is also where a mistake of ours ends: logged whole, told as a problem document without any of it.
"""

import time
import uuid

import structlog
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.api.problems import render_problem
from app.api.route_name import route_name
from app.errors import TadaError

log = structlog.get_logger()

QUIET_PATHS = frozenset({"/healthz", "/readyz"})


class RequestLog:
    """ASGI middleware: binds the request's id to all that is logged meanwhile."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Time the request and log its end."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id, started, status = uuid.uuid4().hex, time.perf_counter(), 0

        async def stamped_send(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message.get("headers", ()), (b"x-request-id", request_id.encode())]
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            try:
                await self._app(scope, receive, stamped_send)
            except Exception:
                log.exception("request_crashed", route=route_name(scope))
                if status:  # the answer has begun: all that is left is to cut it
                    raise
                crash = TadaError("Something went wrong on the server. It is logged; nothing was kept.")
                await render_problem(crash)(scope, receive, stamped_send)
            finally:
                if scope["path"] not in QUIET_PATHS:
                    log.info(
                        "request",
                        method=scope["method"],
                        route=route_name(scope),
                        status=status,
                        milliseconds=round(1000 * (time.perf_counter() - started), 1),
                    )
