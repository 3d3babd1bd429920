"""Signing in: the same answer to all who may not, limits by address and by name, sessions that end."""

import threading
import uuid
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

import pytest
from fastapi.testclient import TestClient
from pwdlib.hashers.argon2 import Argon2Hasher

from app.core.errors import UnavailableError
from app.main import create_app
from app.metrics.instruments import REGISTRY
from app.people.access import sign_in as signing_in
from app.people.access.caller import SESSION_IDLE
from app.people.access.last_use import LastUse
from app.people.access.passwords import MAX_CONCURRENT, MAX_WAITING, Passwords, _hasher, _random_hash
from app.people.models import AccessToken, SignInAttempt, Staff
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


def test_session_token_is_shown_once_with_its_expiry_and_ends_by_signing_out(client, olga):
    answer = sign_in(client, "olga")
    body = answer.json()
    assert answer.headers["cache-control"] == "private, no-store"
    assert (body["name"], body["is_admin"], body["idle_minutes"]) == ("olga", False, 120)
    ends = datetime.fromisoformat(body["expires_at"]) - datetime.now(UTC)
    assert timedelta(hours=11, minutes=59) < ends <= timedelta(hours=12)
    headers = bearer(body["token"])
    assert client.get("/v1/sessions/current", headers=headers).json()["roles"] == {"pilot": "viewer"}
    assert client.delete("/v1/sessions/current", headers=headers).status_code == 204
    assert client.get("/v1/studies", headers=headers).status_code == 401
    assert olga.get("/v1/studies").status_code == 200


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


def test_refused_password_change_changes_nothing(client, olga):
    for current, new, refused in (
        (OTHER, OTHER, (401, "sign_in_failed")),
        (PASSWORD, PASSWORD, (422, "password_refused")),
        (PASSWORD, "short", (422, "password_refused")),
    ):
        change = {"current_password": current, "new_password": new}
        answer = olga.post("/v1/sessions/current/password", json=change)
        assert (answer.status_code, answer.json()["code"]) == refused
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


def test_unicode_forms_of_a_password_are_equal(client, admin):
    client.post("/v1/staff", headers=admin, json={"name": "rene", "password": "cr\u00e8me br\u00fbl\u00e9e au four"})
    assert sign_in(client, "rene", "cre\u0300me bru\u0302le\u0301e au four").status_code == 201


@pytest.mark.usefixtures("full_password_cost")
def test_password_is_kept_as_argon2id_and_a_hash_of_older_cost_is_renewed_at_the_next_sign_in(client, olga, state):
    def kept(**columns):
        with state.database.write() as session:
            row = session.query(Staff).filter_by(name="olga").one()
            for name, value in columns.items():
                setattr(row, name, value)
            return row.password_hash

    form = "$argon2id$v=19$m=65536,t=3,p=4$"
    assert kept().startswith(form)
    kept(password_hash=Argon2Hasher(time_cost=1, memory_cost=1024, parallelism=1).hash(PASSWORD))
    assert sign_in(client, "olga").status_code == 201
    assert kept().startswith(form)
    assert sign_in(client, "olga").status_code == 201


def test_audit_log_has_sessions_and_sign_outs_and_no_name_of_a_refused_sign_in(client, olga, state):
    sign_in(client, "my password by mistake", OTHER)
    olga.delete("/v1/sessions/current")
    with state.database.read() as session:
        events = [(row.actor, row.action) for row in session.query(AuditEvent) if row.action.startswith("session.")]
    assert events == [("olga", "session.open"), ("olga", "session.end")]


def test_tries_are_limited_by_address_and_counted_and_lock_no_name_out_elsewhere(crowd):
    """Ten wrong passwords from any address kept the person herself out."""
    before = {outcome: tries(outcome) for outcome in ("failed", "limited")}
    answers = [sign_in(crowd("192.0.2.1"), "olga", OTHER) for _ in range(5)]
    assert [answer.status_code for answer in answers] == [401, 401, 401, 429, 429]
    assert int(answers[3].headers["retry-after"]) >= 1
    assert answers[3].json()["code"] == "rate_limited"
    assert {outcome: tries(outcome) - before[outcome] for outcome in before} == {"failed": 3, "limited": 2}
    assert sign_in(crowd("198.51.100.7"), "olga").status_code == 201
    statuses = [sign_in(crowd("192.0.2.2"), f"name {n}").status_code for n in range(10)]
    assert statuses == [401] * 9 + [429]


@pytest.fixture
def crowd(settings, monkeypatch):
    """One person who has a password, and a way to call from any address. A minute of the limits lasts a day."""
    monkeypatch.setattr(signing_in, "WINDOW", timedelta(days=1))
    app = create_app(settings.model_copy(update={"sign_in_attempts_per_minute": 3}))
    with TestClient(app) as client:
        api = client.app.state.api
        kept = api.part(Passwords).hash(PASSWORD, name="olga")
        with api.database.write() as session:
            session.add(
                Staff(id=uuid.uuid4(), name="olga", is_admin=False, password_hash=kept, created_at=datetime.now(UTC))
            )

        def call_from(address):
            return TestClient(app, raise_server_exceptions=False, client=(address, 1))

        yield call_from


def test_crowd_is_slowed_by_name_but_not_where_the_person_signed_in_before(crowd):
    herself = crowd("198.51.100.7")
    assert sign_in(herself, "olga").status_code == 201
    statuses = [sign_in(crowd(f"192.0.2.{n}"), "olga", OTHER).status_code for n in range(32)]
    assert statuses.count(429) >= 2
    assert sign_in(crowd("203.0.113.9"), "olga").status_code == 429  # a new place waits
    assert sign_in(herself, "olga").status_code == 201


def test_processes_count_together_and_old_attempts_are_forgotten(crowd, settings, monkeypatch):
    assert [sign_in(crowd("192.0.2.1"), "olga", OTHER).status_code for _ in range(3)] == [401] * 3
    with TestClient(create_app(settings.model_copy(update={"sign_in_attempts_per_minute": 3}))) as another:
        elsewhere = TestClient(another.app, client=("192.0.2.1", 1))
        assert sign_in(elsewhere, "olga").status_code == 429
    assert sign_in(crowd("192.0.2.9"), "olga").status_code == 201
    monkeypatch.setattr(signing_in, "FAILURES_KEPT", timedelta())
    database = crowd("192.0.2.9").app.state.api.database
    signing_in.forget_attempts(database)
    with database.read() as session:
        assert [row.is_success for row in session.query(SignInAttempt)] == [True]


def test_wrong_current_passwords_are_limited(crowd):
    herself = crowd("198.51.100.7")
    headers = bearer(sign_in(herself, "olga").json()["token"])
    change = {"current_password": OTHER, "new_password": "quite another battery"}
    answers = [herself.post("/v1/sessions/current/password", headers=headers, json=change) for _ in range(4)]
    assert [answer.status_code for answer in answers] == [401, 401, 429, 429]


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
