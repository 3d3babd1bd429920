"""Refused calls as phones and staff see them; that a refused upload loses nothing."""

import pytest

from app.http.rate_limit import CallLimits
from app.people.access import caller
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair


@pytest.fixture
def limited(client, settings, monkeypatch):
    """limited(device_uploads_per_minute=1): the app as if it had been started with these settings; no time passes."""

    def limited(**changes):
        limits = CallLimits(settings.model_copy(update=changes), lambda: 0.0)
        state = client.app.state.api
        others = state.part
        monkeypatch.setattr(state, "part", lambda kind: limits if kind is CallLimits else others(kind))

    return limited


def test_refused_upload_is_told_when_to_come_back_another_phone_s_is_not_and_the_same_again_is_kept(enrol, limited):
    phone, other = enrol("P001"), enrol("P002")
    limited(device_uploads_per_minute=1)
    assert phone.post(pair(1)).status_code == 202
    meal = meal_metadata()
    refused = phone.post(pair(2), meal)
    assert (refused.status_code, refused.json()["code"]) == (429, "rate_limited")
    assert refused.json()["retryable"] is True
    assert 1 <= int(refused.headers["retry-after"]) <= 60
    assert phone.get(f"/v1/meals/{meal['id']}").status_code == 404
    assert other.post(pair()).status_code == 202
    limited()
    assert phone.post(pair(2), meal).status_code == 202


def test_what_is_left_is_told_in_headers(phone, limited):
    limited(device_calls_per_minute=60)
    first, second = phone.get("/v1/me"), phone.get("/v1/me")
    assert first.headers["ratelimit-policy"] == '"call";q=60;w=60'
    assert [answer.headers["ratelimit"].split(";")[1] for answer in (first, second)] == ["r=59", "r=58"]


def test_address_past_its_limit_is_refused_before_any_token_is_looked_up_but_not_its_health_checks(
    client, limited, monkeypatch
):
    limited(address_calls_per_minute=2)
    looked_up = []
    monkeypatch.setattr(
        "app.people.access.access_rules.authenticate", lambda *_: looked_up.append(1) or caller.authenticate(*_)
    )
    headers = {"Authorization": "Bearer wrong"}
    assert [client.get("/v1/me", headers=headers).status_code for _ in range(4)] == [401, 401, 429, 429]
    assert len(looked_up) == 2
    assert client.get("/healthz").status_code == 200


def test_persons_exports_and_calls_are_counted_apart(client, admin, limited):
    limited(exports_per_minute=1)
    assert [client.get("/v1/records?format=csv", headers=admin).status_code for _ in range(2)] == [200, 429]
    assert client.get("/v1/records", headers=admin).status_code == 200


def test_packed_body_is_refused_and_told_what_is_taken(client):
    answer = client.post("/v1/enrolments", content=b"x", headers={"Content-Encoding": "gzip"})
    assert (answer.status_code, answer.json()["code"]) == (415, "body_packed")
    assert answer.headers["accept-encoding"] == "identity"
