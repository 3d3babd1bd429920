"""Limits of calls: how many a caller has in a minute and at once, and what each call counts as."""

import uuid

import pytest

from app.core.errors import RateLimitedError
from app.core.settings import Settings
from app.http.rate_limit import CallLimits, call_class


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def limits(clock=None, **changes):
    return CallLimits(Settings(**changes), clock or Clock())


def phone():
    return "device", str(uuid.uuid4())


def person():
    return "staff", str(uuid.uuid4())


@pytest.mark.parametrize(
    ("method", "path", "query", "accept", "found"),
    [
        ("POST", "/v1/meals", b"", b"*/*", "upload"),
        ("PUT", "/v1/meals/a/images/left", b"", b"*/*", "upload"),
        ("POST", "/v1/checks", b"", b"*/*", "upload"),
        ("GET", "/v1/meals/a", b"wait=25", b"*/*", "call"),
        ("POST", "/v1/meals/a/events", b"", b"*/*", "call"),
        ("POST", "/v1/calibrations/a/withdrawal", b"", b"*/*", "call"),
        ("GET", "/v1/records", b"study=a", b"*/*", "call"),
        ("GET", "/v1/records", b"study=a&format=csv", b"*/*", "export"),
        ("GET", "/v1/me/export", b"", b"*/*", "export"),
        ("GET", "/v1/exported", b"", b"*/*", "call"),
        ("GET", "/healthz", b"", b"*/*", None),
        ("GET", "/v1/records", b"", b"text/csv", "export"),
        ("GET", "/v1/records", b"study=a", b"application/vnd.apache.parquet, */*", "export"),
        ("GET", "/v1/records", b"format=json", b"text/csv", "call"),
    ],
)
def test_call_counts_as_what_it_costs(method, path, query, accept, found):
    scope = {"method": method, "path": path, "query_string": query, "headers": [(b"accept", accept)]}
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


def test_quota_headers_follow_the_draft():
    clock = Clock()
    told = limits(clock, device_calls_per_minute=60).count(*phone(), "call")
    assert told.headers("call") == {"RateLimit-Policy": '"call";q=60;w=60', "RateLimit": '"call";r=59;t=1'}
