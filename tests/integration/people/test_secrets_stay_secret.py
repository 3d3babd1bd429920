"""Passwords, tokens and codes, all used in one session, stand in no log line, error, address or database.

Not in the clear, nor as somebody would write them down: base64, hex, escaped in an address.
"""

import base64
import io
import json
import logging
import pathlib
import urllib.parse

import pytest
import sqlalchemy as sa
import structlog

from app.people.access.last_use import LastUse
from tests.integration.people.people import bearer, sign_in
from tests.support.photographs import pair

PASSWORD, NEW_PASSWORD, WRONG_PASSWORD = "first-Passw0rd of olga", "second-Passw0rd of olga", "a-wr0ng guess of hers"


@pytest.fixture
def log():
    """All that is logged, at the lowest level, from everything."""
    written = io.StringIO()
    handler = logging.StreamHandler(written)
    root = logging.getLogger()
    before = root.level
    root.addHandler(handler)
    root.setLevel(logging.DEBUG)
    configuration = structlog.get_config()
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(written))
    yield written
    structlog.configure(**configuration)
    root.removeHandler(handler)
    root.setLevel(before)


class Recorder:
    """A client that keeps every address it asked for and every answer."""

    def __init__(self, client):
        self._client = client
        self.addresses, self.errors, self.answers = [], [], []

    def __call__(self, method, path, headers=None, **arguments):
        answer = self._client.request(method, path, headers=headers or {}, **arguments)
        self.addresses += [str(answer.request.url), answer.headers.get("location", "")]
        self.answers.append(answer)
        if answer.status_code >= 400:
            self.errors.append(f"{answer.headers} {answer.text}")
        return answer


@pytest.fixture
def session(client, admin, state, log):
    """A session in which every kind of secret is made, used, used wrongly and ended: (recorder, secrets)."""
    call = Recorder(client)
    secrets = {PASSWORD, NEW_PASSWORD, WRONG_PASSWORD, admin["Authorization"].removeprefix("Bearer ")}
    call("POST", "/v1/studies", admin, json={"code": "pilot", "name": "Pilot", "marker": "plain:9x7:11"})
    call("POST", "/v1/staff", admin, json={"name": "olga", "password": PASSWORD})
    call("POST", "/v1/staff", admin, json={"name": PASSWORD, "password": PASSWORD.upper()})  # is the name: refused
    call("POST", "/v1/staff", admin, json={"name": "rita", "password": WRONG_PASSWORD[:11]})
    call("POST", "/v1/staff", admin, json={"name": "rita", "password": [WRONG_PASSWORD]})
    call("PUT", "/v1/studies/pilot/members/olga", admin, json={"role": "owner"})
    for wrong in ({"password": WRONG_PASSWORD}, {"password": WRONG_PASSWORD, "extra": WRONG_PASSWORD}):
        call("POST", "/v1/sessions", json={"name": "olga"} | wrong)
    call("POST", "/v1/sessions", content=f'{{"name": "olga", "password": "{WRONG_PASSWORD}"'.encode())
    call("POST", "/v1/sessions", json={"name": WRONG_PASSWORD, "password": "olga"})  # swapped by mistake
    token = sign_in(client, "olga", PASSWORD).json()["token"]
    olga = bearer(token)
    personal = call("POST", "/v1/tokens", olga, json={"name": "script", "scope": "write"}).json()["token"]
    call("GET", "/v1/studies/pilot", bearer(personal))
    call("POST", "/v1/tokens", bearer(personal), json={"name": "no"})
    call("POST", "/v1/studies/pilot/participants", bearer(personal), json={"code": "P1"})
    codes = "/v1/studies/pilot/participants/P1/enrolment-codes"
    ended = call("POST", codes, olga).json()["code"]
    call("POST", codes, olga | {"Accept": "image/png"})
    code = call("POST", codes, olga).json()["code"]
    call("POST", "/v1/enrolments", json={"code": ended, "device_name": "phone"})
    call("POST", "/v1/enrolments", json={"code": code, "device_name": "x" * 300})
    phone = call("POST", "/v1/enrolments", json={"code": code, "device_name": "phone"}).json()["token"]
    call("POST", "/v1/enrolments", json={"code": code, "device_name": "phone"})
    call("GET", "/v1/me", bearer(phone))
    call("GET", "/v1/staff", bearer(phone))
    files = {slot: (f"{slot}.jpg", content, "image/jpeg") for slot, content in pair().items()}
    call("POST", "/v1/meals", bearer(phone), files=files | {"metadata": ("m", json.dumps({"id": code}))})
    call("GET", "/v1/me", bearer(phone[:-1]))
    change = {"current_password": PASSWORD, "new_password": NEW_PASSWORD}
    call("POST", "/v1/sessions/current/password", olga, json=change | {"current_password": WRONG_PASSWORD})
    call("POST", "/v1/sessions/current/password", olga, json=change)
    call("GET", "/v1/sessions/current", olga)  # ended
    again = call("POST", "/v1/sessions", json={"name": "olga", "password": NEW_PASSWORD}).json()["token"]
    call("DELETE", "/v1/sessions/current", bearer(again))
    call("DELETE", "/v1/me/device", bearer(phone))
    call("GET", "/v1/me", bearer(phone))
    state.part(LastUse).settle()
    assert len(call.errors) >= 15
    secrets |= {token, personal, ended, code, phone, again}
    return call, secrets


def spellings(secret):
    """A secret as it may stand somewhere: as it is, escaped, and what encodings leave of it."""
    raw = secret.encode()
    yield raw
    yield urllib.parse.quote(secret).encode()
    yield raw.hex().encode()
    yield base64.b64encode(raw).rstrip(b"=")[:-2]
    yield base64.urlsafe_b64encode(raw).rstrip(b"=")[:-2]


def found_in(content, secrets):
    content = content if isinstance(content, bytes) else content.encode()
    return [secret for secret in secrets if any(spelling in content for spelling in spellings(secret))]


def dump(state):
    """All bytes that the database keeps: SQLite's files with the write-ahead log."""
    path = sa.make_url(state.database.url).database
    return b"".join(pathlib.Path(path + end).read_bytes() for end in ("", "-wal"))


def test_secrets_are_shown_once_and_nowhere_else(session, log, state, settings):
    call, secrets = session
    assert len(secrets) == 10
    assert "request" in log.getvalue()
    assert found_in(log.getvalue(), secrets) == []
    for error in call.errors:
        assert found_in(error, secrets) == [], error
    assert found_in("\n".join(call.addresses), secrets) == []
    kept = dump(state)
    assert b"olga" in kept  # it is the database of this session
    assert found_in(kept, secrets) == []
    for path in settings.data_dir.rglob("*"):
        if path.is_file():
            assert found_in(path.read_bytes(), secrets) == [], path
    told = [(secret, answer) for answer in call.answers for secret in found_in(answer.content, secrets)]
    assert len(told) == len({secret for secret, _ in told})
    assert {answer.headers["cache-control"] for _, answer in told} == {"private, no-store"}


def test_request_that_crashes_logs_no_secret(client, admin, log, monkeypatch):
    def crash(*arguments, **named):
        raise RuntimeError("a mistake of ours")

    monkeypatch.setattr("app.people.access.sign_in.sign_in", crash)
    answer = sign_in(client, "olga", PASSWORD)
    assert answer.status_code == 500
    assert "a mistake of ours" in log.getvalue()
    assert found_in(log.getvalue() + answer.text, {PASSWORD}) == []
