"""At most N calls a minute for a key, in this process: a bucket that refills steadily. Memory is bounded."""

import ipaddress
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from starlette.requests import Request

from app.core.errors import RateLimitedError

MAX_KEYS = 10_000  # the least recently seen go first; a flood of addresses cannot fill the memory
IPV6_HOME = 64  # bits that a network gives to one customer: who has one such address has 2^64 of them


@dataclass(frozen=True, slots=True)
class Quota:
    """What a key has left: whole calls, and the seconds until the bucket is full again."""

    left: int
    full_in_seconds: int


class RateLimit:
    """A token bucket a key (address, name). Endpoints run in threads: one lock keeps a burst from passing at once.

    What is refused is not counted: who comes back after the time that was told is let in.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.per_minute = per_minute
        self._capacity = float(per_minute)
        self._per_second = per_minute / 60
        self._clock = clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def take(self, key: str) -> Quota:
        """Count one call: what is left. Raises RateLimitedError when the key has none left."""
        with self._lock:
            now = self._clock()
            level, since = self._buckets.pop(key, (self._capacity, now))
            level = min(self._capacity, level + (now - since) * self._per_second)
            is_let_in = level >= 1
            if is_let_in:
                level -= 1
            self._buckets[key] = (level, now)
            if len(self._buckets) > MAX_KEYS:
                self._buckets.popitem(last=False)
        if not is_let_in:
            wait = max(1, math.ceil((1 - level) / self._per_second))
            raise RateLimitedError(
                f"Too many calls: come back in {wait} s.",
                retry_after_seconds=wait,
                limit_per_minute=self.per_minute,
            )
        return Quota(int(level), math.ceil((self._capacity - level) / self._per_second))


def caller_address(request: Request) -> str:
    """Whom a limit by address counts: an IPv4 address, or an IPv6 home network.

    Behind proxies it is the address that a trusted one forwards (app/cli/serving.py), never what the caller claims.
    """
    return home_of(request.client.host) if request.client else "unknown"


def home_of(host: str) -> str:
    """An IPv4 address as it is, an IPv6 address as its home network; anything else as it is."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])  # without the zone of a link-local address
    except ValueError:
        return host[:100]
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, IPV6_HOME), strict=False))


class EnrolmentLimit(RateLimit):
    """How often an address may try an enrolment code."""
