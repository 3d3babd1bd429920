"""Signing in: the same answer to all who may not, limits by address and by name, sessions that end."""

import threading
import uuid
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

import pytest
from fastapi.testclient import TestClient

from app.core.errors import UnavailableError
from app.http.rate_limit import RateLimit
from app.main import create_app
from app.metrics.instruments import REGISTRY
from app.people.access.caller import SESSION_IDLE
from app.people.access.last_use import LastUse
from app.people.access.passwords import MAX_CONCURRENT, MAX_WAITING, Passwords, _hasher, _random_hash
from app.people.models import AccessToken, Staff
from app.people.privacy_models import AuditEvent
from tests.integration.people.people import PASSWORD, bearer, make_staff, sign_in
from tests.support.waiting import PATIENCE_SECONDS, wait_until

OTHER = "staple of another horse"


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"sign_in_attempts_per_minute": 60})


@pytest.fixture
def olga(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "Pilot"})
    return make_staff(client, admin, "olga", pilot="viewer")


def test_session_token_is_shown_once_with_its_expiry(client, olga):
    answer = sign_in(client, "olga")
    body = answer.json()
    assert answer.headers["cache-control"] == "private, no-store"
    assert (body["name"], body["is_admin"], body["idle_minutes"]) == ("olga", False, 120)
    ends = datetime.fromisoformat(body["expires_at"]) - datetime.now(UTC)
    assert timedelta(hours=11, minutes=59) < ends <= timedelta(hours=12)
    assert client.get("/v1/sessions/current", headers=bearer(body["token"])).json()["roles"] == {"pilot": "viewer"}


def test_unknown_wrong_and_disabled_give_the_same_answer(client, admin, olga):
    make_staff(client, admin, "gone")
    client.patch("/v1/staff/gone", headers=admin, json={"is_disabled": True})
    answers = [
        sign_in(client, "olga", OTHER),
        sign_in(client, "nobody"),
        sign_in(client, "gone"),
        sign_in(client, "admin"),  # has no password
        sign_in(client, "no name at all: @/?"),
        sign_in(client, "olga", ""),
        sign_in(client, "olga", PASSWORD + "x" * 500),
    ]
    assert {answer.status_code for answer in answers} == {401}
    assert len({answer.text for answer in answers}) == 1
    assert answers[0].json()["code"] == "sign_in_failed"


@pytest.mark.usefixtures("full_password_cost")
def test_every_refusal_does_the_same_work(client, admin, olga, state, monkeypatch):
    checked = []
    check = state.part(Passwords)._hasher.verify_and_update

    def counted(password, stored):
        checked.append(stored.split("$")[:4])
        return check(password, stored)

    monkeypatch.setattr(state.part(Passwords)._hasher, "verify_and_update", counted)
    for name in ("olga", "nobody", "admin"):
        sign_in(client, name, OTHER)
    assert len(checked) == 3
    assert checked[0] == checked[1] == checked[2]  # the same algorithm at the same cost


@pytest.mark.usefixtures("full_password_cost")
def test_no_password_matches_the_dummy_hash():
    passwords = Passwords()
    assert not passwords.check("nobody has this password", None).is_right
    assert not _hasher().current_hasher.check_needs_rehash(_random_hash())
    assert _random_hash() != _random_hash()


def test_sign_out_ends_the_session(olga):
    assert olga.delete("/v1/sessions/current").status_code == 204
    assert olga.get("/v1/studies").status_code == 401


def test_session_ends_unused_and_at_its_time(client, olga, state):
    def age(**columns):
        state.part(LastUse).settle()
        with state.database.write() as session:
            row = session.query(AccessToken).filter_by(kind="session").one()
            for name, value in columns.items():
                setattr(row, name, value)

    now = datetime.now(UTC)
    age(last_used_at=now - SESSION_IDLE + timedelta(minutes=1))
    assert olga.get("/v1/studies").status_code == 200
    age(last_used_at=now - SESSION_IDLE - timedelta(minutes=1))
    assert olga.get("/v1/studies").status_code == 401
    age(last_used_at=now, expires_at=now)
    assert olga.get("/v1/studies").status_code == 401


def own_token(caller, name):
    made = caller.post("/v1/tokens", json={"name": name, "scope": "read", "days": 30})
    assert made.status_code == 201, made.text
    return bearer(made.json()["token"])


def test_own_password_changes_and_all_sessions_and_personal_tokens_end(client, olga):
    """A token made with a password that somebody else knew outlived the password's change."""
    elsewhere, script = bearer(sign_in(client, "olga").json()["token"]), own_token(olga, "nightly export")
    assert client.get("/v1/studies", headers=script).status_code == 200
    change = {"current_password": PASSWORD, "new_password": OTHER}
    answer = olga.post("/v1/sessions/current/password", json=change)
    assert (answer.status_code, answer.json()) == (200, {"sessions": 2, "tokens": ["nightly export"]})
    assert olga.get("/v1/studies").status_code == 401
    assert client.get("/v1/studies", headers=elsewhere).status_code == 401
    assert client.get("/v1/studies", headers=script).status_code == 401
    assert sign_in(client, "olga").status_code == 401
    assert sign_in(client, "olga", OTHER).status_code == 201


@pytest.mark.parametrize(
    ("change", "status", "code"),
    [
        ({"current_password": OTHER, "new_password": OTHER}, 401, "sign_in_failed"),
        ({"current_password": PASSWORD, "new_password": PASSWORD}, 422, "password_refused"),
        ({"current_password": PASSWORD, "new_password": "short"}, 422, "password_refused"),
    ],
)
def test_refused_password_change_changes_nothing(client, olga, change, status, code):
    answer = olga.post("/v1/sessions/current/password", json=change)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert olga.get("/v1/studies").status_code == 200
    assert sign_in(client, "olga").status_code == 201


def test_admin_gives_a_new_password_and_sessions_and_tokens_end(client, admin, olga, state):
    script = own_token(olga, "nightly export")
    changed = client.patch("/v1/staff/olga", headers=admin, json={"password": OTHER})
    assert changed.json()["ended"] == {"sessions": 1, "tokens": ["nightly export"]}
    assert olga.get("/v1/studies").status_code == 401
    assert client.get("/v1/studies", headers=script).status_code == 401
    assert sign_in(client, "olga", OTHER).status_code == 201
    with state.database.read() as session:
        (event,) = session.query(AuditEvent).filter_by(action="staff.change")
    assert event.details == {"fields": ["password"], "sessions_ended": 1, "tokens_ended": 1}


@pytest.mark.both_stores
def test_first_password_ends_no_token(client, admin):
    """Who was made by the command line has a token and no password: nobody can have misused one."""
    changed = client.patch("/v1/staff/admin", headers=admin, json={"password": OTHER})
    assert changed.json()["ended"] == {"sessions": 0, "tokens": []}
    assert client.get("/v1/studies", headers=admin).status_code == 200


@pytest.mark.parametrize(
    "password", ["password1234", "Passw0rd2026!", "qwertyuiop12", "123456789012", "iloveyou1234", "olga.olga.olga"]
)
def test_common_password_is_refused(client, admin, olga, password):
    answer = client.patch("/v1/staff/olga", headers=admin, json={"password": password})
    assert (answer.status_code, answer.json()["code"]) == (422, "password_refused")
    assert sign_in(client, "olga").status_code == 201


def test_unicode_forms_of_a_password_are_equal(client, admin):
    client.post("/v1/staff", headers=admin, json={"name": "rene", "password": "cr\u00e8me br\u00fbl\u00e9e au four"})
    assert sign_in(client, "rene", "cre\u0300me bru\u0302le\u0301e au four").status_code == 201


@pytest.mark.usefixtures("full_password_cost")
def test_hash_of_older_cost_is_renewed_at_the_next_sign_in(client, admin, olga, state):
    from pwdlib.hashers.argon2 import Argon2Hasher

    with state.database.write() as session:
        cheap = Argon2Hasher(time_cost=1, memory_cost=1024, parallelism=1).hash(PASSWORD)
        session.query(Staff).filter_by(name="olga").one().password_hash = cheap
    assert sign_in(client, "olga").status_code == 201
    with state.database.read() as session:
        assert "$m=65536,t=3,p=4$" in session.query(Staff).filter_by(name="olga").one().password_hash
    assert sign_in(client, "olga").status_code == 201


def test_audit_log_has_sessions_and_sign_outs_and_no_name_of_a_refused_sign_in(client, olga, state):
    sign_in(client, "my password by mistake", OTHER)
    olga.delete("/v1/sessions/current")
    with state.database.read() as session:
        events = [(row.actor, row.action) for row in session.query(AuditEvent) if row.action.startswith("session.")]
    assert events == [("olga", "session.open"), ("olga", "session.end")]


@pytest.fixture
def stopped_clock(monkeypatch):
    """No try is given back while a slow machine makes the next."""
    monkeypatch.setattr(RateLimit.__init__, "__defaults__", (lambda: 0.0,))


@pytest.fixture
def strict_client(settings, stopped_clock):
    strict = settings.model_copy(update={"sign_in_attempts_per_minute": 3})
    with TestClient(create_app(strict), raise_server_exceptions=False) as client:
        yield client


def test_tries_of_a_name_are_limited_by_address(strict_client):
    answers = [sign_in(strict_client, "olga") for _ in range(4)]
    assert [answer.status_code for answer in answers] == [401, 401, 401, 429]
    assert int(answers[3].headers["retry-after"]) >= 1
    assert answers[3].json()["code"] == "rate_limited"


def test_tries_of_many_names_are_limited_by_address(strict_client):
    statuses = [sign_in(strict_client, f"name {n}").status_code for n in range(10)]
    assert statuses == [401] * 9 + [429]


@pytest.fixture
def crowd(settings, stopped_clock):
    """One person who has a password, and a way to call from any address."""
    app = create_app(settings.model_copy(update={"sign_in_attempts_per_minute": 3}))
    with TestClient(app) as client:
        with client.app.state.api.database.write() as session:
            make_person(session, "olga", client.app.state.api.part(Passwords).hash(PASSWORD, name="olga"))

        def call_from(address):
            return TestClient(app, raise_server_exceptions=False, client=(address, 1))

        yield call_from


def make_person(session, name, password_hash):
    now = datetime.now(UTC)
    session.add(Staff(id=uuid.uuid4(), name=name, is_admin=False, password_hash=password_hash, created_at=now))


def test_wrong_tries_from_elsewhere_do_not_lock_a_name_out(crowd):
    """Ten wrong passwords from any address kept the person herself out."""
    stranger, herself = crowd("192.0.2.1"), crowd("198.51.100.7")
    assert [sign_in(stranger, "olga", OTHER).status_code for _ in range(5)] == [401, 401, 401, 429, 429]
    assert sign_in(herself, "olga").status_code == 201


def test_crowd_is_slowed_by_name_but_not_where_the_person_signed_in_before(crowd):
    herself = crowd("198.51.100.7")
    assert sign_in(herself, "olga").status_code == 201
    statuses = [sign_in(crowd(f"192.0.2.{n}"), "olga", OTHER).status_code for n in range(32)]
    assert statuses.count(429) >= 2
    assert sign_in(crowd("203.0.113.9"), "olga").status_code == 429  # a new place waits
    assert sign_in(herself, "olga").status_code == 201


def test_wrong_current_passwords_are_limited(strict_client, settings):
    statuses = []
    api = strict_client.app.state.api
    with api.database.write() as session:
        make_person(session, "paul", api.part(Passwords).hash(PASSWORD, name="paul"))
    headers = bearer(sign_in(strict_client, "paul").json()["token"])
    for _ in range(4):
        change = {"current_password": OTHER, "new_password": "quite another battery"}
        statuses.append(strict_client.post("/v1/sessions/current/password", headers=headers, json=change).status_code)
    assert statuses == [401, 401, 429, 429]


def test_tries_are_counted_for_the_alert(strict_client):
    before = {outcome: tries(outcome) for outcome in ("failed", "limited")}
    for _ in range(4):
        sign_in(strict_client, "olga")
    assert tries("failed") == before["failed"] + 3
    assert tries("limited") == before["limited"] + 1


def tries(outcome):
    return REGISTRY.get_sample_value("tada_sign_ins_total", {"outcome": outcome}) or 0


def test_hashing_is_bounded_and_too_many_hear_to_come_back(monkeypatch):
    passwords = Passwords()
    running, most, go, lock = 0, 0, threading.Event(), threading.Lock()

    def slow(password, stored):
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        go.wait(PATIENCE_SECONDS)
        with lock:
            running -= 1
        return False, None

    monkeypatch.setattr(passwords._hasher, "verify_and_update", slow)

    def attempt(_):
        try:
            return passwords.check("x", None)
        except UnavailableError as error:
            wait_until(lambda: most == MAX_CONCURRENT, "as many as may run to run")
            go.set()  # the room is full: let those in it go on
            return error

    callers = MAX_CONCURRENT + MAX_WAITING + 1
    with ThreadPoolExecutor(callers) as pool:
        answers = list(pool.map(attempt, range(callers)))
    assert most == MAX_CONCURRENT
    assert sum(isinstance(answer, UnavailableError) for answer in answers) == 1
