import pytest

from app.core.errors import RateLimitedError
from app.http.rate_limit import MAX_KEYS, RateLimit


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_call_past_the_limit_is_refused_and_told_when_to_come_back():
    clock = Clock()
    limit = RateLimit(3, clock)
    for _ in range(3):
        limit.take("a")
    with pytest.raises(RateLimitedError) as caught:
        limit.take("a")
    assert caught.value.facts["retry_after_seconds"] == 20
    clock.now = 20.0
    limit.take("a")


def test_other_key_has_its_own_limit():
    limit = RateLimit(1, Clock())
    limit.take("a")
    limit.take("b")


def test_memory_is_bounded():
    limit = RateLimit(1, Clock())
    for n in range(MAX_KEYS + 50):
        limit.take(str(n))
    assert len(limit._buckets) == MAX_KEYS


def test_burst_from_many_threads_passes_the_limit_only():
    from concurrent.futures import ThreadPoolExecutor

    limit = RateLimit(5, Clock())

    def attempt(_):
        try:
            limit.take("a")
        except RateLimitedError:
            return 0
        return 1

    with ThreadPoolExecutor(16) as pool:
        assert sum(pool.map(attempt, range(200))) == 5
