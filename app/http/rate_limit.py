"""How many calls an address and a caller may make of one process: uploads, exports and all others counted apart.

An address is counted before anything is looked up, a caller (a phone, a person of the staff) once
their token is known (people/access/access_rules.py). What an address may do is enough for a clinic
with hundreds of phones behind one address; what one phone may do is enough for one that was offline
for weeks. A refused call has lost nothing: it was not read.
"""

import ipaddress
import math
import re
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection
from starlette.types import Scope

from app.core.errors import RateLimitedError
from app.core.settings import Settings
from app.http.file_formats import FORMATS

CallClass = Literal["upload", "export", "call"]
CallerKind = Literal["address", "device", "staff"]

# bits that a network gives to one customer: who has one such address has 2^64 of them
IPV6_HOME = 64
UPLOAD_PATHS = re.compile(
    r"^/v1/(meals(/[^/]+(/images/[^/]+(/upload)?|/after)?)?|checks|calibrations|barcodes)$"
)
EXPORT_PATHS = re.compile(r"/export$|/exports/[^/]+/file$|/releases/[^/]+/(files/|check$)")
BACKGROUND_PATHS = re.compile(r"/(exports|releases)$")
EXPORT_TYPES = tuple(form.content_type.encode() for form in FORMATS.values())  # in Accept
# asked by machines of the people who run the server
UNCOUNTED_PATHS = frozenset({"/healthz", "/readyz", "/metrics"})
AT_ONCE_RETRY_SECONDS = 2
MAX_KEYS = 100_000  # of one limit, so that a flood of addresses cannot fill the memory: 20 MB


@dataclass(frozen=True, slots=True)
class Quota:
    """What a key has left of a limit: whole calls, and the seconds until the bucket is full again."""

    per_minute: int
    left: int
    full_in_seconds: int

    def headers(self, call: CallClass) -> dict[str, str]:
        """The limit and what is left of it, as draft-ietf-httpapi-ratelimit-headers-10 writes them."""
        return {
            "RateLimit-Policy": f'"{call}";q={self.per_minute};w=60',
            "RateLimit": f'"{call}";r={self.left};t={self.full_in_seconds}',
        }


class RateLimit:
    """A token bucket per key (address, caller), refilled steadily.

    A refused call is not counted: whoever comes back after the time in the refusal is let in.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.per_minute = per_minute
        self._per_second = per_minute / 60
        self._clock = clock
        self._lock = threading.Lock()
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # calls left, and when

    def take(self, key: str) -> Quota | None:
        """Count one call and return what is left; None where the limit is 0, which is none.

        Raises RateLimitedError when the key has none left.
        """
        if not self.per_minute:
            return None
        with self._lock:
            now = self._clock()
            level, since = self._buckets.pop(key, (float(self.per_minute), now))
            level = min(float(self.per_minute), level + (now - since) * self._per_second)
            is_let_in = level >= 1
            if is_let_in:
                level -= 1
            self._buckets[key] = level, now
            if len(self._buckets) > MAX_KEYS:
                self._buckets.popitem(last=False)
        if not is_let_in:
            raise too_many_calls(math.ceil((1 - level) / self._per_second), self.per_minute)
        full_in_seconds = math.ceil((self.per_minute - level) / self._per_second)
        return Quota(self.per_minute, int(level), full_in_seconds)


class CallLimits:
    """The limits of one process. A limit of 0 a minute is none."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._at_once = settings.max_connections_per_address
        self._under_way: Counter[str] = Counter()  # changed in the event loop's thread alone
        of_address = RateLimit(settings.address_calls_per_minute, clock)
        of_staff = RateLimit(settings.staff_calls_per_minute, clock)
        self._limits: Mapping[CallerKind, Mapping[CallClass, RateLimit]] = {
            "address": {
                "upload": RateLimit(settings.address_uploads_per_minute, clock),
                "export": of_address,
                "call": of_address,
            },
            "device": {
                "upload": RateLimit(settings.device_uploads_per_minute, clock),
                "export": RateLimit(settings.exports_per_minute, clock),
                "call": RateLimit(settings.device_calls_per_minute, clock),
            },
            "staff": {
                "upload": of_staff,
                "export": RateLimit(settings.exports_per_minute, clock),
                "call": of_staff,
            },
        }

    def count(self, kind: CallerKind, key: str, call: CallClass) -> Quota | None:
        """Count a call; None: not limited. Raises RateLimitedError."""
        return self._limits[kind][call].take(key)

    @contextmanager
    def under_way(self, address: str, call: CallClass) -> Iterator[None]:
        """A call of an address, from its start to its end. Raises RateLimitedError."""
        self.count("address", address, call)
        if self._under_way[address] >= self._at_once:
            raise RateLimitedError(
                f"Your address has {self._at_once} requests under way, the limit.",
                retry_after_seconds=AT_ONCE_RETRY_SECONDS,
                limit_at_once=self._at_once,
            )
        self._under_way[address] += 1
        try:
            yield
        finally:
            self._under_way[address] -= 1
            if not self._under_way[address]:
                del self._under_way[address]


def too_many_calls(wait_seconds: int, per_minute: int) -> RateLimitedError:
    """Return the refusal of a key that has used up its calls."""
    return RateLimitedError(
        f"Too many calls: come back in {wait_seconds} s.",
        retry_after_seconds=wait_seconds,
        limit_per_minute=per_minute,
    )


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


def caller_address(request: HTTPConnection) -> str:
    """Whom a limit by address counts: an IPv4 address, or an IPv6 home network.

    Behind proxies it is the address that a trusted one forwards (app/cli/serving.py), never what
    the caller claims.
    """
    return home_of(request.client.host) if request.client else "unknown"


def home_of(host: str) -> str:
    """An IPv4 address as it is, an IPv6 address as its home network; anything else as it is."""
    try:
        # without the zone of a link-local address
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host[:100]
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, IPV6_HOME), strict=False))


class EnrolmentLimit(RateLimit):
    """How often an address may try an enrolment code."""
