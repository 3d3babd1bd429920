"""Limits of calls: how many a caller has in a minute and at once, and what each call counts as."""

import uuid

import pytest

from app.core.errors import RateLimitedError
from app.core.settings import Settings
from app.http.rate_limit import CallLimits, RateLimit, call_class


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


def limits(clock=None, **changes):
    return CallLimits(Settings(**changes), clock or Clock())


def phone():
    return "device", str(uuid.uuid4())


def person():
    return "staff", str(uuid.uuid4())


@pytest.mark.parametrize(
    ("method", "path", "query", "found"),
    [
        ("POST", "/v1/meals", b"", "upload"),
        ("PUT", "/v1/meals/a/images/left", b"", "upload"),
        ("POST", "/v1/checks", b"", "upload"),
        ("GET", "/v1/meals/a", b"wait=25", "call"),
        ("POST", "/v1/meals/a/events", b"", "call"),
        ("POST", "/v1/calibrations/a/withdrawal", b"", "call"),
        ("GET", "/v1/records", b"study=a", "call"),
        ("GET", "/v1/records", b"study=a&format=csv", "export"),
        ("GET", "/v1/me/export", b"", "export"),
        ("GET", "/v1/exported", b"", "call"),
        ("GET", "/healthz", b"", None),
    ],
)
def test_call_counts_as_what_it_costs(method, path, query, found):
    assert call_class({"method": method, "path": path, "query_string": query, "headers": []}) == found


@pytest.mark.parametrize(
    ("accept", "query", "found"),
    [
        (b"text/csv", b"", "export"),
        (b"application/vnd.apache.parquet, */*", b"study=a", "export"),
        (b"text/csv", b"format=json", "call"),
        (b"*/*", b"", "call"),
    ],
)
def test_file_asked_for_by_the_header_counts_as_an_export(accept, query, found):
    scope = {"method": "GET", "path": "/v1/records", "query_string": query, "headers": [(b"accept", accept)]}
    assert call_class(scope) == found


def test_phone_past_its_uploads_is_refused_may_still_ask_and_is_admitted_after_retry_after():
    clock = Clock()
    counted, caller = limits(clock, device_uploads_per_minute=2), phone()
    assert counted.count(*caller, "upload").left == 1
    counted.count(*caller, "upload")
    for _ in range(5):
        with pytest.raises(RateLimitedError) as caught:
            counted.count(*caller, "upload")
    assert caught.value.facts == {"retry_after_seconds": 30, "limit_per_minute": 2}
    counted.count(*caller, "call")
    counted.count(*phone(), "upload")
    clock.now += 30
    counted.count(*caller, "upload")
    counted, caller = limits(exports_per_minute=1, staff_calls_per_minute=2), person()
    counted.count(*caller, "export")
    with pytest.raises(RateLimitedError):
        counted.count(*caller, "export")
    counted.count(*caller, "call")


def test_limit_of_nought_is_none():
    counted = limits(device_uploads_per_minute=0, address_uploads_per_minute=0)
    caller = phone()
    for _ in range(100):
        assert counted.count(*caller, "upload") is None
        with counted.under_way("192.0.2.1", "upload"):
            pass


def test_requests_at_the_same_time_of_one_address_are_bounded_and_forgotten_when_they_end():
    counted = limits(max_connections_per_address=2)
    with counted.under_way("a", "call"):
        with counted.under_way("a", "call"):
            with pytest.raises(RateLimitedError) as caught, counted.under_way("a", "call"):
                pass
            assert caught.value.facts["limit_at_once"] == 2
            with counted.under_way("b", "call"):
                pass
        with counted.under_way("a", "call"):
            pass
    assert counted.active.total() == 0


def test_quota_headers_follow_the_draft():
    clock = Clock()
    told = limits(clock, device_calls_per_minute=60).count(*phone(), "call")
    assert told.headers("call") == {"RateLimit-Policy": '"call";q=60;w=60', "RateLimit": '"call";r=59;t=1'}
