"""At most N calls a minute for a key, in this process: a bucket that refills steadily. Memory is bounded."""

import time
from collections import OrderedDict
from collections.abc import Callable

from app.errors import RateLimitedError

MAX_KEYS = 10_000  # the least recently seen go first; a flood of addresses cannot fill the memory


class RateLimit:
    """A token bucket a key (address, device)."""

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._capacity = float(per_minute)
        self._per_second = per_minute / 60
        self._clock = clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, key: str) -> None:
        """Count one call. Raises RateLimitedError when the key has none left."""
        now = self._clock()
        level, since = self._buckets.pop(key, (self._capacity, now))
        level = min(self._capacity, level + (now - since) * self._per_second)
        if level < 1:
            self._buckets[key] = (level, now)
            wait = max(1, round((1 - level) / self._per_second))
            raise RateLimitedError(f"Too many tries: come back in {wait} s.", retry_after_seconds=wait)
        self._buckets[key] = (level - 1, now)
        if len(self._buckets) > MAX_KEYS:
            self._buckets.popitem(last=False)
