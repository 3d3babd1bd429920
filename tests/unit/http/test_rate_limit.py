import pytest

from app.core.errors import RateLimitedError
from app.http.rate_limit import RateLimit
from app.http.shared_memory import MAX_KEYS


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_call_past_the_limit_is_refused_and_told_when_to_come_back_and_another_key_has_its_own():
    clock = Clock()
    limit = RateLimit(3, clock)
    for _ in range(3):
        limit.take("a")
    with pytest.raises(RateLimitedError) as caught:
        limit.take("a")
    assert caught.value.facts["retry_after_seconds"] == 20
    clock.now = 20.0
    limit.take("a")
    limit = RateLimit(1, Clock())
    limit.take("a")
    limit.take("b")


def test_memory_is_bounded():
    clock = Clock()
    limit = RateLimit(1, clock)
    size = len(limit._buckets._memory)
    for n in range(2 * MAX_KEYS):
        clock.now += 1e-4
        limit.take(str(n))
    assert len(limit._buckets._memory) == size
    forgotten = [n for n in range(2 * MAX_KEYS) if limit._buckets.get(str(n)) is None]
    assert len(forgotten) >= MAX_KEYS  # which ones: by chance, for a key's set depends on a random seed
    limit.take(str(forgotten[0]))  # it starts afresh
    with pytest.raises(RateLimitedError):
        limit.take(str(2 * MAX_KEYS - 1))


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
