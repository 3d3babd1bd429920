"""How many calls an address and a caller may make: uploads, exports and all others counted apart, in this process.

An address is counted before anything is looked up, a caller (a phone, a person of the staff) once their token is known
(access_rules.py). What an address may do is enough for a clinic with hundreds of phones behind one address; what one
phone may do is enough for one that was offline for weeks. A call that is refused has lost nothing: it was not read.
"""

import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.errors import RateLimitedError
from app.core.settings import Settings
from app.http.problems import render_problem
from app.http.rate_limit import Quota, RateLimit, caller_address
from app.people.access.caller import Caller, DeviceCaller

CallClass = Literal["upload", "export", "call"]

UPLOAD_PATHS = re.compile(r"^/v1/(meals(/[^/]+(/images/[^/]+|/after)?)?|checks|calibrations)$")
EXPORT_PATHS = re.compile(r"/export$|/exports/[^/]+/file$|/releases/[^/]+/(files/|check$)")
BACKGROUND_PATHS = re.compile(r"/(exports|releases)$")
EXPORT_TYPES = (b"text/csv", b"application/x-ndjson", b"application/vnd.apache.parquet")  # in Accept
UNCOUNTED_PATHS = frozenset({"/healthz", "/readyz", "/metrics"})  # asked by machines of the people who run the server
AT_ONCE_RETRY_SECONDS = 2


@dataclass(frozen=True, slots=True)
class CallerQuota:
    """Where a caller stands in one class of calls: for the headers of the answer."""

    name: CallClass
    per_minute: int
    quota: Quota

    @property
    def headers(self) -> list[tuple[bytes, bytes]]:
        """As draft-ietf-httpapi-ratelimit-headers-10 writes it: the rule, and what is left of it."""
        return [
            (b"ratelimit-policy", f'"{self.name}";q={self.per_minute};w=60'.encode()),
            (b"ratelimit", f'"{self.name}";r={self.quota.left};t={self.quota.full_in_seconds}'.encode()),
        ]


class CallLimits:
    """The buckets of one process. A limit of 0 a minute is none."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._at_once = settings.max_connections_per_address
        self._under_way: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._of_addresses: dict[CallClass, RateLimit] = {
            "upload": RateLimit(settings.address_uploads_per_minute, clock),
            "call": RateLimit(settings.address_calls_per_minute, clock),
        }
        self._of_devices: dict[CallClass, RateLimit] = {
            "upload": RateLimit(settings.device_uploads_per_minute, clock),
            "call": RateLimit(settings.device_calls_per_minute, clock),
            "export": RateLimit(settings.exports_per_minute, clock),
        }
        self._of_staff: dict[CallClass, RateLimit] = {
            "call": RateLimit(settings.staff_calls_per_minute, clock),
            "export": RateLimit(settings.exports_per_minute, clock),
        }

    def enter(self, address: str, call: CallClass) -> None:
        """Count a call of an address that begins. Raises RateLimitedError; else `leave` must follow."""
        limit = self._of_addresses["upload" if call == "upload" else "call"]
        if limit.per_minute:
            limit.take(address)
        with self._lock:
            if self._under_way[address] >= self._at_once:
                raise RateLimitedError(
                    f"Your address has {self._at_once} requests under way, the limit.",
                    retry_after_seconds=AT_ONCE_RETRY_SECONDS,
                    limit_at_once=self._at_once,
                )
            self._under_way[address] += 1

    def leave(self, address: str) -> None:
        """The call has ended."""
        with self._lock:
            self._under_way[address] -= 1
            if not self._under_way[address]:
                del self._under_way[address]

    def count_caller(self, caller: Caller, call: CallClass) -> CallerQuota | None:
        """Count a call of a caller whose token is known; None: not limited. Raises RateLimitedError."""
        if isinstance(caller, DeviceCaller):
            limit, key = self._of_devices[call], str(caller.device_id)
        else:
            limit, key = self._of_staff.get(call, self._of_staff["call"]), str(caller.staff_id)
        if not limit.per_minute:
            return None
        return CallerQuota(call, limit.per_minute, limit.take(key))


def call_class(scope: Scope) -> CallClass | None:
    """What a request counts as; None: not at all."""
    path, is_safe = scope["path"], scope["method"] in {"GET", "HEAD"}
    if path in UNCOUNTED_PATHS:
        return None
    if not is_safe and scope["method"] != "DELETE" and UPLOAD_PATHS.match(path):
        return "upload"
    if is_safe and (EXPORT_PATHS.search(path) or _wants_file(scope)):
        return "export"
    if scope["method"] == "POST" and BACKGROUND_PATHS.search(path):
        return "export"
    return "call"


def _wants_file(scope: Scope) -> bool:
    """Whether a file of everything is asked for rather than a page, by the parameter or else by the header."""
    query: bytes = scope["query_string"]
    formats = parse_qs(query.decode("latin-1")).get("format")
    if formats is not None:
        return formats[-1] != "json"
    accepts: list[bytes] = [value for name, value in scope["headers"] if name == b"accept"]
    return any(value.startswith(EXPORT_TYPES) for value in accepts)


def count_caller(request: Request, limits: CallLimits, caller: Caller) -> None:
    """Count the call of a caller whom the route lets in, and keep what is left for the answer's headers."""
    call = call_class(request.scope)
    if call is None:
        return
    quota = limits.count_caller(caller, call)
    if quota is not None:
        request.state.caller_quota = quota


class AddressLimit:
    """ASGI middleware: refuses what an address has too many of; tells callers in headers what they have left."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the call, or refuse it before its body is read."""
        call = call_class(scope) if scope["type"] == "http" else None
        if call is None:
            await self._app(scope, receive, send)
            return
        limits: CallLimits = scope["app"].state.api.part(CallLimits)
        address = caller_address(Request(scope))
        is_waiting = any(name == b"expect" for name, _ in scope["headers"])

        async def noted_receive() -> Message:
            nonlocal is_waiting
            is_waiting = False  # uvicorn tells it to go on
            return await receive()

        async def told_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                quota: CallerQuota | None = scope.get("state", {}).get("caller_quota")
                more = [*quota.headers] if quota is not None else []
                if is_waiting:  # will its body come or not? Nobody knows: the next request needs a new connection
                    more.append((b"connection", b"close"))
                message["headers"] = [*message.get("headers", ()), *more]
            await send(message)

        try:
            limits.enter(address, call)
        except RateLimitedError as error:
            await render_problem(error)(scope, receive, told_send)
            return
        try:
            await self._app(scope, noted_receive, told_send)
        finally:
            limits.leave(address)
