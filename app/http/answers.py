"""What holds for every request and every answer, whatever the route.

Requests: calls are counted by address; no body is larger than its route needs, or comes too slowly;
none is packed, and no address holds a NUL. Uploads count their own bytes (upload.py). PostgreSQL
can neither store nor compare a NUL. A packed body (Content-Encoding) is refused: a kilobyte may
unpack to a gigabyte, and photographs hardly shrink. So is a part of one (Content-Range), which
would be kept as if it were the whole (RFC 9110, section 14.5). HEAD is GET; the server leaves its
body out.

Answers: nothing that a browser guesses at or keeps (amounts of food are health data, tokens are
secrets), what the caller has left of their limit, and in a 405 all methods that the address takes.
"""

import asyncio
import re
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager, nullcontext

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import (
    InvalidInputError,
    MalformedRequestError,
    RequestTimeoutError,
    TadaError,
    TooLargeError,
    UnavailableError,
    UnsupportedMediaError,
)
from app.http.problems import render_problem
from app.http.rate_limit import CallClass, CallLimits, call_class, caller_address
from app.http.state import ApiState

PREFIX = "/v1/"
NOT_KEPT = "private, no-store"
UPLOADS = re.compile(
    r"^/v1/(meals(/[^/]+(/images/[^/]+(/upload)?)?)?|checks|calibrations)$"
    r"|^/dashboard/studies/[^/]+/taught-foods/[^/]+/photographs$"
)
LIMIT_BYTES = 256 * 1024
# in others these headers describe nothing (RFC 9110, section 9.3)
WITH_BODY = frozenset({"POST", "PUT", "PATCH"})
NOT_ALLOWED = 405
# in `stall_seconds`: 270 bytes/s, less than any network that carries photographs
MIN_PROGRESS_BYTES = 16 * 1024
STOP_RETRY_SECONDS = 5
# what logs and limits read of a request once it is routed
OF_ROUTING = ("route", "endpoint", "path_params")


class AroundPath:
    """ASGI middleware that puts another one around the addresses of a pattern."""

    def __init__(self, app: ASGIApp, pattern: re.Pattern[str], middleware: type) -> None:
        self._app, self._pattern, self._within = app, pattern, middleware(app)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the call on."""
        is_within = scope["type"] == "http" and self._pattern.match(scope["path"])
        await (self._within if is_within else self._app)(scope, receive, send)


class Edge:
    """ASGI middleware around all routes. calls: (method, path pattern) of all of them."""

    def __init__(self, app: ASGIApp, calls: Collection[tuple[str, str]]) -> None:
        self._app, self._calls = app, calls

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the call on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        exchange = _Exchange(scope, receive, send, self._allowed_methods)
        call = call_class(scope)
        try:
            with _counted(scope, call) if call is not None else nullcontext():
                body = await _checked_body(scope, exchange.receive)
                await self._app(exchange.routed, body, exchange.send)
        except TadaError as error:
            answer = render_problem(error)
            if error.code == "body_packed":
                answer.headers["Accept-Encoding"] = "identity"  # RFC 9110, section 15.5.16
            await answer(scope, receive, exchange.send)
        except asyncio.CancelledError:  # the server ends, and has waited for `stop_seconds`
            if exchange.is_answered:
                raise
            await render_problem(_server_stops())(scope, receive, exchange.send)

    def _allowed_methods(self, path: str) -> list[str]:
        """Those that an address takes; none where there is no such address."""
        taken = {method for method, pattern in self._calls if compile_path(pattern)[0].match(path)}
        return sorted(taken | ({"HEAD"} if "GET" in taken else set()))


class _Exchange:
    """One request and its answer.

    routed: the scope for the app, into which routing writes; of HEAD it is GET's
    is_answered: an answer has begun
    """

    def __init__(
        self,
        scope: Scope,
        receive: Receive,
        send: Send,
        allowed_methods: Callable[[str], list[str]],
    ) -> None:
        self._scope, self._receive, self._send = scope, receive, send
        self._allowed_methods = allowed_methods
        self._state = scope.setdefault("state", {})
        self.routed = {**scope, "method": "GET"} if scope["method"] == "HEAD" else scope
        self.is_answered = False
        # the caller asks whether the body is wanted, and nobody has received any of it
        self._is_expecting = any(name == b"expect" for name, _ in scope["headers"])
        self._stall_seconds = _state_of(scope).settings.stall_seconds
        # time that the app does not ask in does not count
        self._patience_seconds = self._stall_seconds
        self._progress_bytes = 0
        self._is_whole = False

    async def receive(self) -> Message:
        """Receive, as long as the body makes progress. Raises RequestTimeoutError."""
        self._is_expecting = False  # uvicorn tells the caller to go on
        if self._is_whole:  # what comes now is the end of the connection
            return await self._receive()
        loop = asyncio.get_running_loop()
        started = loop.time()
        try:
            async with asyncio.timeout(self._patience_seconds):
                message = await self._receive()
        except TimeoutError:
            raise _body_too_slow(self._stall_seconds) from None
        self._patience_seconds -= loop.time() - started
        self._progress_bytes += len(message.get("body", b""))
        if self._progress_bytes >= MIN_PROGRESS_BYTES:
            self._patience_seconds, self._progress_bytes = self._stall_seconds, 0
        self._is_whole = not message.get("more_body", False)
        return message

    async def send(self, message: Message) -> None:
        """Send, with the headers that all answers have."""
        if message["type"] == "http.response.start":
            self.is_answered = True
            self._complete_headers(message)
        await self._send(message)

    def _complete_headers(self, message: Message) -> None:
        scope, routed = self._scope, self.routed
        scope.update({name: routed[name] for name in OF_ROUTING if name in routed})
        headers = MutableHeaders(scope=message)
        headers.update(self._state.get("rate_limit_headers", {}))
        if scope["path"].startswith(PREFIX):
            headers.setdefault("X-Content-Type-Options", "nosniff")
            headers.setdefault("Cache-Control", NOT_KEPT)
        if self._is_expecting or message["status"] == RequestTimeoutError.status:
            # will the body come or not? Nobody knows: the next request needs a new connection
            headers["Connection"] = "close"
        if message["status"] == NOT_ALLOWED and (methods := self._allowed_methods(scope["path"])):
            headers["Allow"] = ", ".join(methods)


def _body_too_slow(stall_seconds: float) -> RequestTimeoutError:
    return RequestTimeoutError(
        f"In {stall_seconds:g} s fewer than {MIN_PROGRESS_BYTES} bytes of the body have come. Nothing was kept: send "
        "it again."
    )


def _server_stops() -> UnavailableError:
    return UnavailableError(
        "The server is being stopped before the request has come to its end. Nothing was kept: send it again.",
        code="server_stops",
        retry_after_seconds=STOP_RETRY_SECONDS,
    )


def _state_of(scope: Scope) -> ApiState:
    state: ApiState = scope["app"].state.api
    return state


def _counted(scope: Scope, call: CallClass) -> AbstractContextManager[None]:
    limits = _state_of(scope).part(CallLimits)
    return limits.under_way(caller_address(HTTPConnection(scope)), call)


async def _checked_body(scope: Scope, receive: Receive) -> Receive:
    """Take the body in, at most the limit, before the app sees the request; an upload's is left to its route.

    Raises InvalidInputError, UnsupportedMediaError, MalformedRequestError, TooLargeError.
    """
    if "\0" in scope["path"] or b"%00" in scope["query_string"] or b"\0" in scope["query_string"]:
        raise InvalidInputError(
            "The address contains the character NUL, which no name of ours does."
        )
    headers = dict(scope["headers"])
    describes_body = scope["method"] in WITH_BODY
    if describes_body and headers.get(b"content-encoding", b"identity").strip().lower() not in (
        b"identity",
        b"",
    ):
        raise UnsupportedMediaError(
            "Send the body unpacked, without Content-Encoding.", code="body_packed"
        )
    if describes_body and b"content-range" in headers:
        raise MalformedRequestError(
            "A body is taken whole: send it without Content-Range.", code="content_range_refused"
        )
    if UPLOADS.match(scope["path"]):
        return receive
    declared = headers.get(b"content-length", b"0")
    received = int(declared) if declared.isdigit() else 0
    messages: list[Message] = []
    if received <= LIMIT_BYTES:
        received, more = 0, True
        while more and received <= LIMIT_BYTES:
            message = await receive()
            messages.append(message)
            received += len(message.get("body", b""))
            more = message["type"] == "http.request" and message.get("more_body", False)
    if received > LIMIT_BYTES:
        raise TooLargeError(
            f"The body is larger than {LIMIT_BYTES} bytes, the limit.", limit_bytes=LIMIT_BYTES
        )

    async def replay() -> Message:
        return messages.pop(0) if messages else await receive()

    return replay
