"""The injected answers of sandbox studies: by a header of any call, or by a field of a meal's metadata.

Neither costs anything where it is absent. Outside a sandbox the header is ignored, and the field is an unknown one,
listed in `ignored` like any other.
"""

import re
import uuid
from collections import OrderedDict
from collections.abc import Callable

import anyio
import anyio.to_thread
from fastapi import FastAPI
from pydantic import JsonValue
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import TadaError
from app.db.session import Database
from app.extras.sandbox.injection import Injection, parse_injection
from app.http.answers import AroundPath
from app.http.state import CUT, ApiState
from app.people.access.caller import DeviceCaller, authenticate
from app.people.access.secret_box import SecretBox
from app.people.access.web_origins import WEB_PATHS
from app.people.models import Study

HEADER = "Tada-Sandbox"
FIELD = "sandbox"  # of a meal's metadata
SENDS_METADATA = re.compile(r"^/v1/meals(/[^/]+)?$")
REMEMBERED = 10_000  # meals whose metadata asked for an answer


def install(app: FastAPI) -> None:
    """Give an app the answers that sandboxes ask for."""
    app.user_middleware.append(  # within all others: they count and log its answers
        Middleware(AroundPath, pattern=WEB_PATHS, middleware=SandboxAnswers)
    )
    app.state.request_headers.append(HEADER)
    app.state.on_metadata = MetadataInjections()


class SandboxAnswers:
    """ASGI middleware that gives the answers that are asked for."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the call on; delay, refuse or lose it where its injection says so. Raises the TadaError of a refusal."""
        text = Headers(scope=scope).get(HEADER)
        injection = await _of_header(scope, text) if text is not None else None
        if injection is not None:
            scope.setdefault("state", {})[FIELD] = injection
            await _begin(injection)
            if injection.lose_request is not None:
                receive = _losing(scope, receive, injection.lose_request)
        elif scope["method"] not in {"POST", "PUT"} or not SENDS_METADATA.match(scope["path"]):
            await self._app(scope, receive, send)
            return
        await self._app(scope, receive, _answering(scope, send))


class MetadataInjections:
    """The MetadataHook of an app. It counts the requests of each meal whose metadata ask for an answer."""

    def __init__(self) -> None:
        self._counts: OrderedDict[tuple[uuid.UUID, uuid.UUID], int] = OrderedDict()

    async def __call__(
        self,
        request: Request,
        caller: DeviceCaller,
        client_id: uuid.UUID,
        unknown: dict[str, JsonValue],
    ) -> str | None:
        """Answer as the header or the metadata of a meal ask; return how its estimate is to end, None: as it does.

        unknown: the metadata's unknown fields; one that is heeded is removed. Raises the TadaError of a refusal.
        """
        of_header: Injection | None = getattr(request.state, FIELD, None)
        text = unknown.get(FIELD)
        if not isinstance(text, str) or not await anyio.to_thread.run_sync(
            _is_sandbox, request.app.state.api.database, caller.study_id
        ):
            return of_header.meal if of_header is not None else None
        del unknown[FIELD]
        injection = parse_injection(text)
        if of_header is not None:
            return of_header.meal
        if self._count(caller.participant_id, client_id) <= injection.times:
            setattr(request.state, FIELD, injection)
            await _begin(injection)
            if injection.lose_request is not None:
                cut_connection(request.scope)
                raise ClientDisconnect
        return injection.meal

    def _count(self, participant_id: uuid.UUID, client_id: uuid.UUID) -> int:
        """Count one more request of a meal, and return how many came."""
        key = participant_id, client_id
        self._counts[key] = self._counts.pop(key, 0) + 1
        if len(self._counts) > REMEMBERED:
            self._counts.popitem(last=False)
        return self._counts[key]


def cut_connection(scope: Scope) -> None:
    """Reset the request's connection; without our server's protocol (tests in process) nothing happens."""
    cut: Callable[[], None] | None = scope.get("state", {}).get(CUT)
    if cut is not None:
        cut()


async def _of_header(scope: Scope, text: str) -> Injection | None:
    """The header's injection if the call is of a sandbox's phone. Raises InvalidInputError."""
    scheme, _, token = Headers(scope=scope).get("authorization", "").partition(" ")
    state: ApiState = scope["app"].state.api
    if scheme.lower() != "bearer" or not await anyio.to_thread.run_sync(
        _is_of_sandbox, state, token.strip()
    ):
        return None
    return parse_injection(text)


def _is_of_sandbox(state: ApiState, token: str) -> bool:
    try:
        caller = authenticate(state.database, state.part(SecretBox), token)
    except TadaError:
        return False  # which the route answers
    return isinstance(caller, DeviceCaller) and _is_sandbox(state.database, caller.study_id)


def _is_sandbox(database: Database, study_id: uuid.UUID) -> bool:
    with database.read() as session:
        return session.get_one(Study, study_id).is_sandbox


async def _begin(injection: Injection) -> None:
    if injection.wait:
        await anyio.sleep(injection.wait)
    if injection.error is not None:
        raise injection.error


def _losing(scope: Scope, receive: Receive, most_bytes: int) -> Receive:
    """A request's body that breaks off."""
    received = 0

    async def receive_part() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received < most_bytes and message.get("more_body", False):
            return message
        cut_connection(scope)
        return {"type": "http.disconnect"}

    return receive_part


def _answering(scope: Scope, send: Send) -> Send:
    """An answer that breaks off, if an injection of the request says so by the time that it begins."""
    start: Message | None = None
    sent = 0

    async def send_part(message: Message) -> None:
        nonlocal start, sent
        injection: Injection | None = scope.get("state", {}).get(FIELD)
        if injection is None or injection.lose_answer is None:
            await send(message)
            return
        if message["type"] == "http.response.start":
            start = message
            return
        body = message.get("body", b"")
        is_lost = sent + len(body) > injection.lose_answer or injection.lose_answer == 0
        if start is not None and injection.lose_answer > 0:
            await send(start)
            start = None
        if not is_lost:
            sent += len(body)
            await send(message)
            return
        if injection.lose_answer > sent:
            await send({**message, "body": body[: injection.lose_answer - sent], "more_body": True})
        cut_connection(scope)

    return send_part
