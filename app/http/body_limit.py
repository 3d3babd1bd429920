"""No request has a body larger than its route needs, none is packed, and none has a NUL in its address.

Uploads have their own limits (upload.py), all other routes this one. PostgreSQL can neither store nor compare a NUL.
A packed body (Content-Encoding) is refused: a kilobyte may unpack to a gigabyte, and photographs hardly shrink. So is a
part of one (Content-Range), which would be kept as if it were the whole (RFC 9110, section 14.5).
"""

import re

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import InvalidInputError, MalformedRequestError, TadaError, TooLargeError, UnsupportedMediaError
from app.http.problems import render_problem

# they count for themselves, part by part
UPLOADS = re.compile(r"^/v1/(meals(/[^/]+(/images/[^/]+)?)?|checks|calibrations)$")
LIMIT_BYTES = 256 * 1024


class BodyLimit:
    """ASGI middleware: takes the body in, at most the limit, before the app sees the request."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with its body at hand."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if "\0" in scope["path"] or b"%00" in scope["query_string"] or b"\0" in scope["query_string"]:
            error: TadaError = InvalidInputError("The address contains the character NUL, which no name of ours does.")
            await render_problem(error)(scope, receive, send)
            return
        headers = dict(scope["headers"])
        if headers.get(b"content-encoding", b"identity").strip().lower() not in (b"identity", b""):
            error = UnsupportedMediaError("Send the body unpacked, without Content-Encoding.", code="body_packed")
            answer = render_problem(error)
            answer.headers["Accept-Encoding"] = "identity"  # RFC 9110, section 15.5.16
            await answer(scope, receive, send)
            return
        if b"content-range" in headers:
            error = MalformedRequestError(
                "A body is taken whole: send it without Content-Range.", code="content_range_refused"
            )
            await render_problem(error)(scope, receive, send)
            return
        if UPLOADS.match(scope["path"]):
            await self._app(scope, receive, send)
            return
        declared = headers.get(b"content-length", b"0")
        if declared.isdigit() and int(declared) > LIMIT_BYTES:
            await render_problem(_too_large())(scope, receive, send)
            return
        messages: list[Message] = []
        received, more = 0, True
        while more:
            message = await receive()
            messages.append(message)
            received += len(message.get("body", b""))
            if received > LIMIT_BYTES:
                await render_problem(_too_large())(scope, receive, send)
                return
            more = message["type"] == "http.request" and message.get("more_body", False)

        async def replay() -> Message:
            return messages.pop(0) if messages else await receive()

        await self._app(scope, replay, send)


def _too_large() -> TooLargeError:
    return TooLargeError(f"The body is larger than {LIMIT_BYTES} bytes, the limit.", limit_bytes=LIMIT_BYTES)
