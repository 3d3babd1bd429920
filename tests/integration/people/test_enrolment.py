from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime

import pytest

from app.http.rate_limit import RateLimit
from app.people.models import AccessToken, Device, Enrolment
from app.people.privacy_models import AuditEvent
from tests.integration.people.people import bearer


def issue(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "s", "name": "s"})
    client.post("/v1/studies/s/participants", headers=admin, json={"code": "P1"})
    return client.post("/v1/studies/s/participants/P1/enrolment-codes", headers=admin).json()["code"]


SECRET, OTHER_SECRET = "s" * 22, "o" * 22


def exchange(client, code, **fields):
    return client.post("/v1/enrolments", json={"code": code, "device_name": "phone"} | fields)


def sign_out(client, token):
    assert client.delete("/v1/me/device", headers=bearer(token)).status_code == 204


def is_invalid(answer):
    return (answer.status_code, answer.json()["code"]) == (404, "enrolment_code_invalid")


def test_code_is_exchanged_once_by_one_secret_or_none(client, admin):
    code = issue(client, admin)
    first = exchange(client, code)
    assert (first.status_code, first.json()["study"], first.json()["participant"]) == (201, "s", "P1")
    assert is_invalid(exchange(client, code))
    assert is_invalid(exchange(client, code, secret=SECRET))
    code = issue(client, admin)
    refused = exchange(client, code, secret="1234")
    assert (refused.status_code, "1234" in refused.text) == (422, False)
    token = exchange(client, code, secret=SECRET).json()["token"]
    for fields in ({}, {"secret": OTHER_SECRET}, {"secret": SECRET + " "}):
        assert is_invalid(exchange(client, code, **fields))
    assert exchange(client, issue(client, admin), secret=SECRET).json()["token"] != token
    sign_out(client, token)
    assert is_invalid(exchange(client, code, secret=SECRET))


@pytest.mark.both_stores
def test_phone_whose_answer_was_lost_gets_the_same_token_again_by_its_secret(client, admin, state):
    code = issue(client, admin)
    first = exchange(client, code, secret=SECRET)
    again = exchange(client, code, secret=SECRET, device_name="renamed")
    assert (first.status_code, again.status_code) == (201, 200)
    assert again.json() == first.json()
    headers = {"Authorization": f"Bearer {again.json()['token']}"}
    assert client.get("/v1/me", headers=headers).json()["participant"] == "P1"
    with state.database.read() as session:
        assert session.query(Device).count() == 1
        enrolments = session.query(AuditEvent).filter(AuditEvent.action == "device.enrol")
        assert enrolments.count() == 1


def test_code_of_a_sandbox_gives_each_secret_one_token_until_its_phone_or_person_is_gone(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "s", "name": "s", "sandbox": True})
    code = issue(client, admin)
    first, again, other = (exchange(client, code, secret=secret) for secret in (SECRET, SECRET, OTHER_SECRET))
    assert [answer.status_code for answer in (first, again, other)] == [201, 200, 201]
    assert first.json() == again.json()
    assert first.json()["token"] != other.json()["token"]
    sign_out(client, first.json()["token"])
    assert is_invalid(exchange(client, code, secret=SECRET))
    phone = bearer(other.json()["token"])
    receipt = client.post("/v1/me/withdrawal", headers=phone).json()["id"]
    assert is_invalid(exchange(client, code, secret=OTHER_SECRET))
    assert client.get("/v1/me", headers=phone).json()["receipt"] == receipt
    assert exchange(client, code, secret="n" * 22).status_code == 201


@pytest.mark.both_stores
def test_concurrent_calls_of_one_phone_get_one_token(client, admin, state):
    code = issue(client, admin)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda _: exchange(client, code, secret=SECRET), range(4)))
    assert sorted(answer.status_code for answer in answers) == [200, 200, 200, 201]
    assert len({answer.json()["token"] for answer in answers}) == 1
    with state.database.read() as session:
        assert session.query(Device).count() == 1


def test_unknown_and_expired_code_give_the_same_answer(client, admin, state):
    code = issue(client, admin)
    with state.database.write() as session:
        session.query(Enrolment).one().expires_at = datetime.now(UTC)
    expired, unknown = exchange(client, code), exchange(client, "x" * 22)
    assert expired.status_code == unknown.status_code == 404
    assert expired.json() == unknown.json()


def test_revoked_and_expired_tokens_are_401(client, admin, state):
    token = exchange(client, issue(client, admin)).json()["token"]
    headers = {"Authorization": f"Bearer {token}"}
    assert client.get("/v1/records", headers=headers).status_code == 200
    for column in ("revoked_at", "expires_at"):
        with state.database.write() as session:
            row = session.query(AccessToken).filter(AccessToken.device_id.is_not(None)).one()
            row.revoked_at = row.expires_at = None
            setattr(row, column, datetime.now(UTC))
        assert client.get("/v1/records", headers=headers).status_code == 401


@pytest.fixture
def stopped_clock(monkeypatch):
    """No try is given back while a slow machine makes the next."""
    monkeypatch.setattr(RateLimit.__init__, "__defaults__", (lambda: 0.0,))


def test_many_tries_are_slowed_down(stopped_clock, client):
    answers = [exchange(client, f"guess-{n}") for n in range(61)]
    assert [answer.status_code for answer in answers] == [404] * 60 + [429]
    assert answers[-1].json()["code"] == "rate_limited"
    assert int(answers[-1].headers["retry-after"]) >= 1
