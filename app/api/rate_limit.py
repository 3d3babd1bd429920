"""At most N calls a minute for a key, in this process: a bucket that refills steadily. Memory is bounded."""

import ipaddress
import threading
import time
from collections import OrderedDict
from collections.abc import Callable

from starlette.requests import Request

from app.errors import RateLimitedError

MAX_KEYS = 10_000  # the least recently seen go first; a flood of addresses cannot fill the memory
IPV6_HOME = 64  # bits that a network gives to one customer: who has one such address has 2^64 of them


class RateLimit:
    """A token bucket a key (address, name). Endpoints run in threads: one lock keeps a burst from passing at once."""

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._capacity = float(per_minute)
        self._per_second = per_minute / 60
        self._clock = clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def take(self, key: str) -> None:
        """Count one call. Raises RateLimitedError when the key has none left."""
        with self._lock:
            now = self._clock()
            level, since = self._buckets.pop(key, (self._capacity, now))
            level = min(self._capacity, level + (now - since) * self._per_second)
            self._buckets[key] = (level - 1 if level >= 1 else level, now)
            if len(self._buckets) > MAX_KEYS:
                self._buckets.popitem(last=False)
        if level < 1:
            wait = max(1, round((1 - level) / self._per_second))
            raise RateLimitedError(f"Too many tries: come back in {wait} s.", retry_after_seconds=wait)


def caller_address(request: Request) -> str:
    """Whom a limit by address counts: an IPv4 address, or an IPv6 home network.

    Behind proxies it is the address that a trusted one forwards (app/serving.py), never what the caller claims.
    """
    host = request.client.host if request.client else "unknown"
    try:
        address = ipaddress.ip_address(host.partition("%")[0])  # without the zone of a link-local address
    except ValueError:
        return host[:100]
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, IPV6_HOME), strict=False))
