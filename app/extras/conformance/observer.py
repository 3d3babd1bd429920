"""An ASGI middleware around the server that records what each phone does, and disturbs it where that shows something.

The disturbances are the sandbox's own answers, asked for in the phone's name, or the server's own refusals. Each comes
once per phone, at the next part of a meal that the phone has not sent yet. Answers get a field that no app knows.
"""

import hashlib
import json
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import Failure
from app.extras.conformance.conversation import Conversation, Exchange, Fault, SentPhotograph
from app.extras.conformance.report import PATHS, app_report, respond
from app.photos.inspect import sniff
from app.photos.slots import PHOTOGRAPH_SLOTS, VIEW_SLOTS

UNKNOWN_FIELD = "conformance_kit"
ASKING_HEADER = "Tada-Sandbox"  # docs/sandbox.md
PLAN: tuple[Fault, ...] = (
    "lost_answer",
    "lost_request",
    "unavailable",
    "rate_limited",
    "not_durable",
)
INJECTIONS: Mapping[Fault, str] = {
    "lost_answer": "lose_answer=0",
    "lost_request": "lose_request=1000",
    "unavailable": "status=503 retry_after=3",
    "rate_limited": "status=429 retry_after=2",
}
# the others are of photographs
OF_METADATA: frozenset[Fault] = frozenset({"lost_answer", "rate_limited"})
MOST_EXCHANGES = 5_000  # of a phone: the oldest go
JSON_TYPES = ("application/json", "application/problem+json")
EXIF = b"Exif\0\0"
_TOKEN = re.compile(r"tada_[A-Za-z0-9_-]{20,}")


@dataclass(slots=True)
class ObservedPhone:
    """A phone by its token. planned: what it is yet to meet."""

    device_name: str
    exchanges: list[Exchange] = field(default_factory=list)
    planned: list[Fault] = field(default_factory=lambda: list(PLAN))
    begun: set[tuple[str, str]] = field(default_factory=set)
    has_changed: bool = False


class Observer:
    """The middleware, and what it has seen. clock: s."""

    def __init__(self, app: ASGIApp, clock: Callable[[], float] = time.monotonic) -> None:
        self._app = app
        self._clock = clock
        self._phones: dict[str, ObservedPhone] = {}  # by the token's SHA-256
        self._codes: set[str] = set()

    def conversations(self) -> list[Conversation]:
        """Return the conversation of each phone, the last enrolled first."""
        now = self._clock()
        return [
            Conversation(phone.device_name, tuple(phone.exchanges), now)
            for phone in reversed(self._phones.values())
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a call on, recorded and perhaps disturbed; answer calls of the report."""
        if scope["type"] == "http" and scope["path"] in PATHS:
            await respond(scope, receive, send, app_report(self.conversations()))
        elif (
            scope["type"] != "http"
            or not scope["path"].startswith("/v1/")
            or scope["method"] == "OPTIONS"
        ):
            await self._app(scope, receive, send)
        else:
            await self._observe(scope, receive, send)

    async def _observe(self, scope: Scope, receive: Receive, send: Send) -> None:
        began = self._clock()
        headers = Headers(scope=scope)
        token = headers.get("authorization", "").partition(" ")[2].strip()
        phone = self._phone(token) if token else None
        body, answer = _Body(receive), _Answer(send)
        if (scope["method"], scope["path"]) == ("POST", "/v1/meals"):
            await body.read()  # it names the meal
        request = Exchange(began, began, scope["method"], scope["path"], None)
        request = replace(request, metadata=(await _parts(scope, body)).metadata)
        fault = _fault_of(phone, request) if phone is not None else None
        await self._pass_on(scope, body, answer, fault, request.metadata)
        parts = await _parts(scope, body)
        address = scope["path"] + "?" + scope["query_string"].decode("latin-1")
        offset = headers.get("upload-offset", "")
        exchange = replace(
            request,
            ended_at=self._clock(),
            status=answer.status,
            is_authorised=phone is not None,
            has_secret_in_url=bool(_TOKEN.search(address))
            or any(code in address for code in self._codes),
            if_match=headers.get("if-match"),
            metadata=parts.metadata,
            photographs=parts.photographs,
            upload_offset=int(offset) if offset.isdecimal() else None,
            retry_after=answer.retry_after,
            answer=answer.document,
            fault=fault,
        )
        if request.path == "/v1/enrolments":
            self._note_enrolment(exchange)
        elif phone is not None:
            phone.exchanges.append(exchange)
            del phone.exchanges[:-MOST_EXCHANGES]

    async def _pass_on(
        self,
        scope: Scope,
        body: "_Body",
        answer: "_Answer",
        fault: Fault | None,
        metadata: Mapping[str, object] | None,
    ) -> None:
        """Have the server answer the request, disturbed by the fault."""
        if fault != "not_durable":
            await self._app(_disturbed(scope, fault), body.replay, answer)
        elif scope["method"] == "PATCH":  # the server loses the pieces that it had
            deletion = {**scope, "method": "DELETE", "headers": _plain_headers(scope)}
            await self._app(deletion, _receive_of(b""), _unheard)
            await self._app(scope, body.replay, answer)
        else:
            await body.read()
            inner, content = _without_photographs(scope, metadata)
            await self._app(inner, _receive_of(content), answer)

    def _phone(self, token: str) -> ObservedPhone:
        return self._phones.setdefault(
            hashlib.sha256(token.encode()).hexdigest(), ObservedPhone("a phone")
        )

    def _note_enrolment(self, exchange: Exchange) -> None:
        """Note the phone that was enrolled, and forget its token's text."""
        body, token = exchange.metadata or {}, exchange.answer.get("token")
        if not isinstance(token, str):
            return
        # one that works: any other text may stand in an address by chance
        self._codes.add(str(body.get("code")))
        phone = self._phone(token)
        phone.device_name = str(body.get("device_name"))
        phone.exchanges.append(
            Exchange(exchange.at, exchange.ended_at, "POST", exchange.path, exchange.status)
        )


@dataclass(frozen=True, slots=True)
class _Parts:
    """metadata: the JSON object that a request consists of, or its part of that name."""

    metadata: dict[str, object] | None = None
    photographs: tuple[SentPhotograph, ...] = ()


class _Body:
    """A request's body: passed on as it comes, or whole, and kept."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._replayed = False
        self.content = bytearray()
        self.is_whole = False

    async def read(self) -> None:
        """Take in all of it."""
        while not self.is_whole:
            message = await self._receive()
            if message["type"] == "http.disconnect":
                return
            self._keep(message)

    async def replay(self) -> Message:
        """Return the next message, as ASGI's `receive` does."""
        if self.is_whole and not self._replayed:
            self._replayed = True
            return {"type": "http.request", "body": bytes(self.content), "more_body": False}
        message = await self._receive()
        self._keep(message)
        self._replayed = True
        return message

    def _keep(self, message: Message) -> None:
        if message["type"] == "http.request":
            self.content += message.get("body", b"")
            self.is_whole = not message.get("more_body", False)


class _Answer:
    """An answer on its way to the phone: JSON gets one more field.

    status: once it was sent whole
    document: the JSON object that was answered, or an empty one
    """

    def __init__(self, send: Send) -> None:
        self._send = send
        self._start: Message = {}
        self._content = bytearray()
        self._is_json = False
        self.status: int | None = None
        self.retry_after: float | None = None
        self.document: dict[str, object] = {}

    async def __call__(self, message: Message) -> None:
        """Send a message, as ASGI's `send` does."""
        if message["type"] == "http.response.start":
            headers = Headers(raw=message["headers"])
            self._is_json = headers.get("content-type", "").startswith(JSON_TYPES)
            after = headers.get("retry-after", "")
            self.retry_after = float(after) if after.isdecimal() else None
            self._start = message
            if not self._is_json:
                await self._send(message)
            return
        is_last = not message.get("more_body", False)
        if not self._is_json:
            await self._send(message)
        else:
            self._content += message.get("body", b"")
            if is_last:
                await self._send_extended()
        if is_last:
            self.status = self._start["status"]

    async def _send_extended(self) -> None:
        content, document = bytes(self._content), _json_object(self._content)
        if document is not None:
            content = json.dumps(document | {UNKNOWN_FIELD: {"ignore": "this"}}).encode()
        headers = MutableHeaders(raw=list(self._start["headers"]))
        headers["content-length"] = str(len(content))
        await self._send({**self._start, "headers": headers.raw})
        await self._send({"type": "http.response.body", "body": content, "more_body": False})
        self.document = document or {}


def _fault_of(phone: ObservedPhone, request: Exchange) -> Fault | None:
    """Return how this request is to be disturbed, and cross it off the phone's plan."""
    if request.method == "POST" and request.path.endswith("/events") and not phone.has_changed:
        phone.has_changed = True
        return "stale"
    content = request.content
    if content is None or content in phone.begun or content[1] not in {"metadata", *VIEW_SLOTS}:
        return None
    phone.begun.add(content)
    is_photograph = content[1] != "metadata" or request.method == "POST"
    for fault in phone.planned:
        if is_photograph or fault in OF_METADATA:
            phone.planned.remove(fault)
            return fault
    return None


def _disturbed(scope: Scope, fault: Fault | None) -> Scope:
    """The request as the server is to see it."""
    headers = MutableHeaders(raw=list(scope["headers"]))
    if fault == "stale" and "if-match" in headers:
        headers["if-match"] = '"0"'
    if fault is not None and fault in INJECTIONS:
        headers[ASKING_HEADER] = INJECTIONS[fault]
    return {**scope, "headers": headers.raw}


def _plain_headers(scope: Scope) -> list[tuple[bytes, bytes]]:
    """Return the headers of a request that do not describe its body."""
    names = {b"authorization", b"host", b"x-app-version", b"tus-resumable"}
    return [(name, value) for name, value in scope["headers"] if name in names]


def _receive_of(content: bytes) -> Receive:
    """Return ASGI's `receive` of a request with this body."""

    async def receive() -> Message:
        return {"type": "http.request", "body": content, "more_body": False}

    return receive


async def _unheard(_: Message) -> None:
    """Drop a message of an answer that nobody waits for."""


def _without_photographs(
    scope: Scope, metadata: Mapping[str, object] | None
) -> tuple[Scope, bytes]:
    """The request and its body as if the server had lost the photographs: the answer still lists them as missing."""
    headers = _plain_headers(scope)
    if scope["method"] == "POST" and metadata is not None:
        path, method = f"/v1/meals/{metadata.get('id')}", "PUT"
        fields = {name: value for name, value in metadata.items() if name != "id"}
        content = json.dumps(fields).encode()
        length = str(len(content)).encode()
        headers += [(b"content-type", b"application/json"), (b"content-length", length)]
    else:
        path, method, content = scope["path"].partition("/images/")[0], "GET", b""
    inner = {
        **scope,
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "headers": headers,
    }
    return inner, content


async def _parts(scope: Scope, body: _Body) -> _Parts:
    """What a request that came whole consists of."""
    content, content_type = bytes(body.content), Headers(scope=scope).get("content-type", "")
    folder, _, slot = scope["path"].rpartition("/images/")
    contents: dict[str, bytes] = {}
    if not body.is_whole:
        return _Parts()
    if content_type.startswith("multipart/form-data"):
        contents = await _form(scope, content)
    elif content_type.startswith("application/json"):
        contents = {"metadata": content}
    elif scope["method"] == "PUT" and folder:
        contents = {slot: content}
    photographs = tuple(
        _photograph(name, part)
        for name, part in contents.items()
        if name in PHOTOGRAPH_SLOTS and part and scope["path"].startswith("/v1/meals")
    )
    return _Parts(_json_object(contents.get("metadata", b"")), photographs)


async def _form(scope: Scope, content: bytes) -> dict[str, bytes]:
    """The parts of a form by name."""
    parts = {}
    try:
        async with Request(scope, _receive_of(content)).form() as form:
            for name, value in form.multi_items():
                parts[name] = value.encode() if isinstance(value, str) else await value.read()
    except Exception:  # noqa: BLE001  # any: the server refuses what cannot be parsed, and says why
        return {}
    return parts


def _photograph(slot: str, content: bytes) -> SentPhotograph:
    media_type = sniff(content)
    return SentPhotograph(
        slot,
        hashlib.sha256(content).hexdigest(),
        None if isinstance(media_type, Failure) else media_type,
        EXIF in content[: 2**18] or media_type == "image/heic",
    )


def _json_object(content: bytes | bytearray) -> dict[str, object] | None:
    try:
        document = json.loads(content)
    except ValueError:
        return None
    return document if isinstance(document, dict) else None
