"""Codes of an app at sign-in: turned on and off, accepted once and in time, guessed at in vain."""

import re
from datetime import timedelta

import pytest
from fastapi.testclient import TestClient

from app.people.access import sign_in as signing_in
from app.people.access import totp
from app.people.access.secret_box import SecretBox
from app.people.models import AccessToken, Staff
from app.people.privacy_models import AuditEvent
from tests.integration.dashboard.conftest import BROWSER
from tests.integration.people.people import PASSWORD, make_staff
from tests.integration.people.test_secrets_stay_secret import dump, found_in
from tests.support.authenticator import code_of

FORM = {"name": "olga", "password": PASSWORD}
OTHER = "staple of another horse"
NOW = 59_525_760  # the number of a time step


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"sign_in_attempts_per_minute": 60})


@pytest.fixture
def clock(monkeypatch):
    """The present time step, which stands still until a test moves it."""
    steps = [NOW]
    monkeypatch.setattr(totp, "_step", lambda now: steps[-1])
    return steps


@pytest.fixture
def olga(clock, sign_in_browser):
    """A person who signed in before she turned her codes on, and the secret of her app."""
    olga = sign_in_browser("olga")
    page = olga.page("/dashboard/account/totp")
    olga.secret = re.search(r'name="secret" value="([A-Z2-7]{32})"', page)[1]
    assert "<svg" in page
    assert olga.post("/dashboard/account/totp", secret=olga.secret, code=code_of(olga.secret, NOW)).status_code == 303
    clock.append(NOW + 10)
    return olga


def call(client, **more):
    answer = client.post("/v1/sessions", json=FORM | more)
    return answer.status_code, answer.json().get("code")


def form(client, **fields):
    return client.post("/dashboard/sign-in", headers=BROWSER, data=fields, follow_redirects=False)


def proof_of(answer):
    return re.search(r'name="proof" value="([^"]+)"', answer.text)[1]


def kept(state, action):
    with state.database.read() as session:
        return [row.details for row in session.query(AuditEvent).filter_by(action=action, actor="olga")]


def test_codes_are_those_of_the_standard():
    """RFC 6238, appendix B, of which apps show the last six digits."""
    secret = "GEZDGNBVGY3TQOJQGEZDGNBVGY3TQOJQ"
    for seconds, code in ((59, "287082"), (1111111109, "081804"), (20000000000, "353130")):
        assert totp._matching_step(secret, code, [seconds // 30]) == seconds // 30
        assert code_of(secret, seconds // 30) == code


@pytest.mark.both_stores
def test_password_alone_opens_nothing_and_a_code_is_accepted_once(client, olga, state, clock):
    assert call(client) == (401, "code_needed")
    assert call(client, code="") == (401, "code_needed")
    code = code_of(olga.secret, NOW + 10)
    assert call(client, code=f"{code[:3]} {code[3:]}") == (201, None)
    assert call(client, code=code) == (401, "code_needed")
    clock.append(NOW + 11)
    assert call(client, code=code) == (401, "code_needed")
    clock.append(NOW + 12)
    assert call(client, code=code_of(olga.secret, NOW + 11)) == (201, None)
    assert call(client, password=OTHER, code=code_of(olga.secret, NOW + 13)) == (401, "sign_in_failed")
    with state.database.read() as session:
        assert session.query(AccessToken).filter_by(kind="session").count() == 4  # two before she turned codes on
    assert olga.get("/dashboard").status_code == 200  # sessions go on


def test_page_asks_for_the_code_in_a_second_step(client, olga, clock):
    asked = form(client, **FORM, next="/dashboard/foods")
    assert (asked.status_code, "set-cookie" in asked.headers, PASSWORD in asked.text) == (401, False, False)
    assert 'role="alert"' not in asked.text
    second = {"name": "olga", "proof": proof_of(asked), "next": "/dashboard/foods"}
    again = form(client, **second, code="000000")
    assert (again.status_code, "wrong, or was used before" in again.text) == (401, True)
    second["proof"] = proof_of(again)
    clock.append(NOW + 11)
    answer = form(client, **second, code=code_of(olga.secret, NOW + 11))
    assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/foods")


def test_proof_of_the_password_is_good_for_its_person_and_password_only_and_for_minutes(
    client, admin, olga, state, monkeypatch
):
    proof = proof_of(form(client, **FORM))
    make_staff(client, admin, "rene")
    code = code_of(olga.secret, NOW + 11)
    for wrong in ({"name": "rene"}, {"proof": proof[:-4] + "AAA="}, {"proof": "x"}, {"proof": "ä"}):
        answer = form(client, **{"name": "olga", "proof": proof, "code": code} | wrong)
        assert (answer.status_code, 'name="password"' in answer.text) == (401, True)
    monkeypatch.setattr(signing_in, "PROOF_SECONDS", -1)
    assert form(client, name="olga", proof=proof, code=code).status_code == 401
    monkeypatch.undo()
    client.patch("/v1/staff/olga", headers=admin, json={"password": OTHER})
    assert form(client, name="olga", proof=proof, code=code).status_code == 401
    with state.database.read() as session:
        assert session.query(Staff).filter_by(name="olga").one().totp_step == NOW  # nobody used a code


def test_code_of_the_step_before_and_after_is_accepted_and_no_other(client, olga, clock):
    for age in (-2, 2):
        assert call(client, code=code_of(olga.secret, clock[-1] - age)) == (401, "code_needed")
        clock.append(clock[-1] + 10)
    for age in (-1, 0, 1):
        assert call(client, code=code_of(olga.secret, clock[-1] - age)) == (201, None)
        clock.append(clock[-1] + 10)


def test_after_a_wrong_code_none_is_accepted_in_its_step_so_that_guesses_from_everywhere_are_two_a_minute(
    client, olga, clock
):
    assert call(client, code="000000") == (401, "code_needed")
    for step in (NOW + 9, NOW + 10, NOW + 11):
        assert call(client, code=code_of(olga.secret, step)) == (401, "code_needed")
    clock.append(NOW + 11)
    assert call(client, code=code_of(olga.secret, NOW + 11)) == (201, None)


def test_guesses_count_as_attempts_of_the_name(app, client, olga, monkeypatch):
    monkeypatch.setattr(signing_in, "WINDOW", timedelta(days=1))
    monkeypatch.setattr(client.app.state.api.part(signing_in.SignInLimits), "_per_minute", 3)
    elsewhere = TestClient(app, client=("192.0.2.1", 1))
    assert [call(elsewhere, code=f"{guess:06}")[0] for guess in range(5)] == [401] * 3 + [429] * 2


def test_secret_is_readable_neither_in_the_database_nor_with_another_key(olga, state):
    assert found_in(dump(state), {olga.secret}) == []
    with state.database.read() as session:
        sealed = session.query(Staff).filter_by(name="olga").one().totp_secret
    assert state.part(SecretBox).open(sealed) == olga.secret
    assert olga.secret not in olga.page("/dashboard/account")


def test_wrong_code_turns_nothing_on_and_the_same_secret_is_shown_again(client, clock, sign_in_browser):
    olga = sign_in_browser("olga")
    secret = "GEZDGNBVGY3TQOJQGEZDGNBVGY3TQOJQ"
    answer = olga.post("/dashboard/account/totp", secret=secret, code="000000")
    assert (answer.status_code, f'value="{secret}"' in answer.text, "This code is wrong" in answer.text) == (
        422,
        True,
        True,
    )
    for broken in ("", "GEZDG", secret.lower(), '"><script>'):
        answer = olga.post("/dashboard/account/totp", secret=broken, code=code_of(secret, NOW))
        assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/account/totp")
    assert call(client) == (201, None)


def test_codes_cannot_be_replaced_by_those_of_another_app_while_they_are_on(client, olga, clock):
    secret = "GEZDGNBVGY3TQOJQGEZDGNBVGY3TQOJQ"
    answer = olga.post("/dashboard/account/totp", secret=secret, code=code_of(secret, clock[-1]))
    assert answer.status_code == 409
    assert call(client, code=code_of(olga.secret, clock[-1])) == (201, None)


@pytest.mark.both_stores
def test_codes_are_turned_off_by_password_and_code(client, olga, state, clock):
    for password, code in ((OTHER, code_of(olga.secret, NOW + 10)), (PASSWORD, "000000"), ("", "")):
        answer = olga.post("/dashboard/account/totp/removal", totp_password=password, code=code)
        assert (answer.status_code, 'class="wrong"' in answer.text) == (422, True)
    clock.append(NOW + 20)
    fields = {"totp_password": PASSWORD, "code": code_of(olga.secret, NOW + 20)}
    assert olga.post("/dashboard/account/totp/removal", **fields).status_code == 303
    assert call(client) == (201, None)
    assert kept(state, "staff.totp") == [{"is_on": True}, {"is_on": False}]
    assert olga.post("/dashboard/account/totp/removal", **fields).status_code == 303  # twice is as once


def test_admin_turns_codes_off_for_who_lost_the_phone_and_sees_who_has_them(
    client, admin, olga, sign_in_browser, state
):
    assert client.get("/v1/staff/olga", headers=admin).json()["has_totp"] is True
    boss = sign_in_browser("boss", is_admin=True)
    assert "Turn codes off" in boss.page("/dashboard/staff")
    assert boss.post("/dashboard/staff/change", name="olga", ends_totp="true").status_code == 303
    assert call(client) == (201, None)
    changed = client.patch("/v1/staff/olga", headers=admin, json={"ends_totp": True}).json()
    assert (changed["has_totp"], changed["ended"]) == (False, {"sessions": 0, "tokens": []})
    with state.database.read() as session:
        (event,) = session.query(AuditEvent).filter_by(action="staff.change", subject="olga")
    assert (event.actor, event.details["fields"]) == ("boss", ["totp"])


def test_personal_tokens_need_no_code(client, olga):
    made = olga.post("/dashboard/account/tokens", name="script", scope="read", days="30").text
    token = re.search(r'id="issued">([^<]+)<', made)[1]
    assert client.get("/v1/studies", headers={"Authorization": f"Bearer {token}"}).status_code == 200
