"""An ASGI middleware around the server that records what each phone does, and disturbs it where that shows something.

The disturbances are the sandbox's own answers, asked for in the phone's name, or the server's own refusals. Each comes
once per phone, at the next part of a meal that the phone has not sent yet. Answers get a field that no app knows.
"""

import hashlib
import json
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from starlette.datastructures import Headers
from starlette.formparsers import MultiPartParser
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
OF_METADATA: frozenset[Fault] = frozenset(
    {"lost_answer", "rate_limited"}
)  # the others are of photographs
MOST_EXCHANGES = 5_000  # of a phone: the oldest go
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
        is_whole = scope["method"] == "POST" and scope["path"] == "/v1/meals"
        body = _Body(receive)
        if is_whole:
            await body.read()  # it names the meal
        request = Exchange(
            began,
            began,
            scope["method"],
            scope["path"],
            None,
            metadata=await _metadata(scope, body),
        )
        fault = _fault_of(phone, request) if phone is not None else None
        answer = _Answer(send)
        if (
            fault == "not_durable" and scope["method"] == "PATCH"
        ):  # the server loses the pieces that it had
            await self._app(
                {**scope, "method": "DELETE", "headers": _plain_headers(scope)}, _nothing, _unheard
            )
            await self._app(scope, body.replay, answer)
        elif fault == "not_durable":
            await body.read()
            inner, passed_on = await _without_photographs(scope, body)
            await self._app(inner, passed_on, answer)
        else:
            await self._app(_disturbed(scope, fault), body.replay, answer)
        target = scope["path"] + "?" + scope["query_string"].decode("latin-1")
        heard = answer.document()
        exchange = Exchange(
            began,
            self._clock(),
            request.method,
            request.path,
            answer.status,
            is_authorised=phone is not None,
            has_secret_in_url=bool(_TOKEN.search(target))
            or any(code in target for code in self._codes),
            if_match=headers.get("if-match"),
            metadata=await _metadata(scope, body),
            photographs=await _photographs(scope, body),
            upload_offset=int(offset)
            if (offset := headers.get("upload-offset", "")).isdecimal()
            else None,
            retry_after=answer.retry_after,
            answer=heard,
            fault=fault,
        )
        if request.path == "/v1/enrolments":
            phone = self._enrolled(exchange)
        if phone is not None:
            phone.exchanges.append(exchange)
            del phone.exchanges[:-MOST_EXCHANGES]

    def _phone(self, token: str) -> ObservedPhone:
        return self._phones.setdefault(
            hashlib.sha256(token.encode()).hexdigest(), ObservedPhone("a phone")
        )

    def _enrolled(self, exchange: Exchange) -> ObservedPhone | None:
        """Note the phone that was enrolled, and forget its token's text."""
        body, token = exchange.metadata or {}, exchange.answer.get("token")
        if not isinstance(token, str):
            return None
        self._codes.add(
            str(body.get("code"))
        )  # one that works: any other text may stand in an address by chance
        phone = self._phone(token)
        phone.device_name = str(body.get("device_name"))
        phone.exchanges.append(
            Exchange(exchange.at, exchange.ended_at, "POST", exchange.path, exchange.status)
        )
        return None


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
    """An answer on its way to the phone: JSON gets one more field."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._start: Message | None = None
        self._content = bytearray()
        self._is_json = False
        self.status: int | None = None
        self.retry_after: float | None = None

    async def __call__(self, message: Message) -> None:
        """Send a message, as ASGI's `send` does."""
        if message["type"] == "http.response.start":
            headers = Headers(raw=message["headers"])
            self._is_json = headers.get("content-type", "").startswith(
                ("application/json", "application/problem+json")
            )
            after = headers.get("retry-after", "")
            self.retry_after = float(after) if after.isdecimal() else None
            self._start = message
            if not self._is_json:
                await self._send(message)
            return
        is_last = not message.get("more_body", False)
        if self._is_json:
            self._content += message.get("body", b"")
            if is_last and self._start is not None:
                await self._send_extended(self._start)
        else:
            await self._send(message)
        if is_last and self._start is not None:
            self.status = self._start["status"]

    def document(self) -> dict[str, object]:
        """The JSON object that was answered, or an empty one."""
        document = (
            json.loads(self._content)
            if self._is_json and self._content and self.status is not None
            else None
        )
        return document if isinstance(document, dict) else {}

    async def _send_extended(self, start: Message) -> None:
        document = json.loads(self._content) if self._content else None
        content = bytes(self._content)
        if isinstance(document, dict):
            content = json.dumps(document | {UNKNOWN_FIELD: {"ignore": "this"}}).encode()
        headers = [
            (name, value) for name, value in start["headers"] if name.lower() != b"content-length"
        ]
        await self._send(
            {**start, "headers": [*headers, (b"content-length", str(len(content)).encode())]}
        )
        await self._send({"type": "http.response.body", "body": content, "more_body": False})


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
    headers: list[tuple[bytes, bytes]] = scope["headers"]
    if fault == "stale":
        return {
            **scope,
            "headers": [(n, b'"0"' if n == b"if-match" else value) for n, value in headers],
        }
    if fault is not None and fault in INJECTIONS:
        asked = (ASKING_HEADER.lower().encode(), INJECTIONS[fault].encode())
        return {**scope, "headers": [*(pair for pair in headers if pair[0] != asked[0]), asked]}
    return scope


def _plain_headers(scope: Scope) -> list[tuple[bytes, bytes]]:
    """Return the headers of a request that do not describe its body."""
    kept = {b"authorization", b"host", b"x-app-version", b"tus-resumable"}
    return [(name, value) for name, value in scope["headers"] if name in kept]


async def _nothing() -> Message:
    return {"type": "http.request", "body": b"", "more_body": False}


async def _unheard(_: Message) -> None:
    """Drop a message of an answer that nobody waits for."""


async def _without_photographs(scope: Scope, body: _Body) -> tuple[Scope, Receive]:
    """The request as if the server had lost the photographs: the answer still lists them as missing."""
    metadata = await _metadata(scope, body)
    headers = _plain_headers(scope)
    if scope["method"] == "POST" and metadata is not None:
        path, method = f"/v1/meals/{metadata.get('id')}", "PUT"
        content = json.dumps(
            {name: value for name, value in metadata.items() if name != "id"}
        ).encode()
        headers += [
            (b"content-type", b"application/json"),
            (b"content-length", str(len(content)).encode()),
        ]
    else:
        path, method, content = scope["path"].partition("/images/")[0], "GET", b""

    async def receive() -> Message:
        return {"type": "http.request", "body": content, "more_body": False}

    inner = {
        **scope,
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "headers": headers,
    }
    return inner, receive


async def _metadata(scope: Scope, body: _Body) -> dict[str, object] | None:
    """The JSON object that a request consists of, or its part `metadata`; None without one."""
    content_type = Headers(scope=scope).get("content-type", "")
    if not body.is_whole:
        return None
    if content_type.startswith("multipart/form-data"):
        part = (await _parts(scope, body)).get("metadata")
        return _json_object(part) if part is not None else None
    return (
        _json_object(bytes(body.content)) if content_type.startswith("application/json") else None
    )


async def _photographs(scope: Scope, body: _Body) -> tuple[SentPhotograph, ...]:
    """The photographs of a request that came whole."""
    path = scope["path"]
    if not body.is_whole or not body.content:
        return ()
    if scope["method"] == "POST" and path == "/v1/meals":
        parts = await _parts(scope, body)
        return tuple(
            _sent(slot, content) for slot, content in parts.items() if slot in PHOTOGRAPH_SLOTS
        )
    slot = path.rpartition("/images/")[2]
    if scope["method"] == "PUT" and path.startswith("/v1/meals/") and slot in PHOTOGRAPH_SLOTS:
        return (_sent(slot, bytes(body.content)),)
    return ()


async def _parts(scope: Scope, body: _Body) -> dict[str, bytes]:
    async def receive() -> Message:
        return {"type": "http.request", "body": bytes(body.content), "more_body": False}

    parser = MultiPartParser(
        Headers(scope=scope), Request(scope, receive).stream(), max_part_size=2**20
    )
    parts = {}
    try:
        form = await parser.parse()
    except Exception:  # noqa: BLE001  # any: the server refuses what cannot be parsed, and says why
        return {}
    for name, value in form.multi_items():
        parts[name] = value.encode() if isinstance(value, str) else await value.read()
    await form.close()
    return parts


def _sent(slot: str, content: bytes) -> SentPhotograph:
    media_type = sniff(content)
    return SentPhotograph(
        slot,
        hashlib.sha256(content).hexdigest(),
        None if isinstance(media_type, Failure) else media_type,
        EXIF in content[: 2**18] or media_type == "image/heic",
    )


def _json_object(content: bytes) -> dict[str, object] | None:
    try:
        document = json.loads(content)
    except ValueError:
        return None
    return document if isinstance(document, dict) else None
