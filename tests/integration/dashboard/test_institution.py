"""Signing in with an institution's account, by a real provider on a socket: linked, refused, attacked."""

import re
import uuid
from datetime import timedelta
from urllib.parse import parse_qs, urlsplit

import httpx2
import pytest

from app.core.settings import Settings
from app.people.access import oidc, totp
from app.people.access import sign_in as signing_in
from app.people.access.secret_box import SecretBox
from app.people.models import Staff
from app.people.privacy_models import AuditEvent
from tests.integration.dashboard.conftest import BROWSER, text_of
from tests.integration.people.test_secrets_stay_secret import dump, found_in
from tests.support.authenticator import code_of
from tests.support.identity_provider import CLIENT, FILTER, SECRET, identity_provider

pytestmark = pytest.mark.filterwarnings(FILTER)

BEGIN = "/dashboard/sign-in/institution"
RETURN = "/dashboard/sign-in/return"
SUBJECT = "olga@hospital.example"


@pytest.fixture(scope="module")
def served():
    with identity_provider() as provider:
        yield provider


@pytest.fixture
def provider(served):
    served.claims, served.algorithm, served.answers = {}, None, {}
    served.calls.clear()
    return served


@pytest.fixture
def settings(settings, provider):
    values = {"oidc_issuer": provider.address, "oidc_client_id": CLIENT, "oidc_client_secret": SECRET}
    return Settings(**settings.model_dump() | values | {"sign_in_attempts_per_minute": 60})


class Stranger:
    """A browser in which nobody is signed in."""

    def __init__(self, client):
        self.client, self.cookies = client, {}

    def request(self, method, path):
        kept = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        headers = BROWSER | ({"Cookie": kept} if kept else {})
        answer = self.client.request(method, path, headers=headers, follow_redirects=False)
        self.client.cookies.clear()
        self.cookies |= dict(answer.cookies)
        return answer

    def get(self, path):
        return self.request("GET", path)

    def post(self, path):
        return self.request("POST", path)


@pytest.fixture
def stranger(client):
    return Stranger(client)


def authorise(page, subject=SUBJECT):
    """Sign in at the provider, and return the address of ours to which it sends the person back."""
    address = re.search(r'href="([^"]+)">Continue', page.text)[1].replace("&amp;", "&")
    assert page.headers["refresh"] == f"0; url={address}"
    answer = httpx2.post(address, data={"sub": subject})
    back = urlsplit(answer.headers["location"])
    assert (answer.status_code, back.path) == (302, RETURN)
    return f"{back.path}?{back.query}"


def sign_in(browser, subject=SUBJECT):
    return browser.get(authorise(browser.post(BEGIN), subject))


def refusal(answer):
    assert "set-cookie" not in answer.headers
    return answer.status_code, re.search(r"<code>(\w+)</code>", answer.text)[1]


@pytest.fixture
def olga(sign_in_browser):
    """A person who has linked her account."""
    olga = sign_in_browser("olga")
    answer = olga.get(authorise(olga.post("/dashboard/account/institution")))
    assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/account")
    assert "End the link" in olga.page("/dashboard/account")
    return olga


@pytest.mark.both_stores
def test_linked_account_signs_in_and_goes_to_the_page_that_was_asked_for(olga, stranger, state, provider):
    assert "Sign in with your institution" in stranger.get("/dashboard/sign-in").text
    answer = stranger.get(authorise(stranger.post(f"{BEGIN}?next=/dashboard/foods")))
    assert (answer.status_code, answer.headers["location"]) == (303, "/dashboard/foods")
    assert "Signed in as olga" in text_of(stranger.get("/dashboard/account").text)
    with state.database.read() as session:
        events = [(row.action, row.details) for row in session.query(AuditEvent).filter_by(actor="olga")]
    assert events[-2:] == [("staff.oidc", {"is_linked": True}), ("session.open", {"by": "oidc"})]
    assert found_in(dump(state), {SUBJECT}) == [] if state.database.is_sqlite else True


def test_page_asks_the_provider_for_a_code_with_pkce_and_keeps_the_flow_where_scripts_cannot_read_it(
    stranger, provider
):
    page = stranger.post(BEGIN)
    query = parse_qs(urlsplit(page.headers["refresh"].partition("url=")[2]).query)
    assert {"response_type", "client_id", "state", "nonce", "code_challenge"} < query.keys()
    assert query["code_challenge_method"] == ["S256"]
    assert (query["redirect_uri"], query["scope"]) == ([f"http://testserver{RETURN}"], ["openid"])
    cookie = page.headers["set-cookie"].lower()
    assert all(part in cookie for part in ("httponly", "samesite=lax", "max-age=600"))
    assert not any(query[name][0].lower() in cookie for name in ("state", "nonce", "code_challenge"))
    assert parse_qs(urlsplit(stranger.post(BEGIN).headers["refresh"]).query)["state"] != query["state"]


def test_under_https_the_flow_is_bound_to_host_and_transport(client, stranger):
    client.base_url = "https://testserver"
    page = stranger.post(BEGIN)
    assert page.headers["set-cookie"].startswith("__Host-tada_flow=")
    assert "Secure" in page.headers["set-cookie"]
    assert "redirect_uri=https%3A%2F%2Ftestserver%2Fdashboard%2Fsign-in%2Freturn" in page.headers["refresh"]


def test_account_that_nobody_linked_is_told_how_and_creates_nobody(stranger, state, admin):
    answer = sign_in(stranger, "stranger")
    assert refusal(answer) == (401, "oidc_unlinked")
    assert "Sign in with your password, then link it" in answer.text
    with state.database.read() as session:
        assert [row.name for row in session.query(Staff)] == ["admin"]


@pytest.mark.parametrize(
    ("claims", "algorithm"),
    [
        ({}, "none"),
        ({}, "HS256"),
        ({}, "other key"),
        ({"nonce": "of another flow"}, None),
        ({"nonce": None}, None),
        ({"aud": "another server"}, None),
        ({"aud": ["another server", CLIENT], "azp": "another server"}, None),
        ({"iss": "https://evil.example"}, None),
        ({"exp": 1_700_000_000}, None),
        ({"exp": None}, None),
        ({"iat": 4_000_000_000}, None),
        ({"nbf": 4_000_000_000}, None),
        ({"sub": None}, None),
        ({"sub": ""}, None),
        ({"sub": 7}, None),
    ],
)
def test_token_that_is_not_signed_for_this_flow_by_the_provider_opens_nothing(
    olga, stranger, provider, claims, algorithm
):
    provider.claims = {"name": "Olga"}
    assert sign_in(stranger).status_code == 303  # signed anew, it is a good token
    provider.claims, provider.algorithm = claims, algorithm
    stranger.cookies.clear()
    assert refusal(sign_in(stranger)) == (401, "oidc_refused")
    assert stranger.get("/dashboard").status_code == 303


def test_code_state_and_cookie_are_good_together_once_and_in_their_browser(olga, client, stranger, monkeypatch):
    back = authorise(stranger.post(BEGIN))
    another = Stranger(client)
    assert refusal(another.get(back)) == (401, "oidc_expired")  # a link that an attacker sends
    another.post(BEGIN)
    assert refusal(another.get(back)) == (401, "oidc_expired")  # while they sign in themselves
    assert refusal(stranger.get(f"{RETURN}?code=x&state=ä")) == (401, "oidc_expired")
    assert refusal(stranger.get(RETURN)) == (401, "oidc_expired")
    assert stranger.get(back).status_code == 303
    assert refusal(stranger.get(back)) == (401, "oidc_refused")  # the code is used
    injected = parse_qs(urlsplit(authorise(another.post(BEGIN), "attacker")).query)["code"][0]
    own = parse_qs(urlsplit(authorise(stranger.post(BEGIN))).query)["state"][0]
    assert refusal(stranger.get(f"{RETURN}?code={injected}&state={own}")) == (401, "oidc_refused")  # by PKCE
    back = authorise(stranger.post(BEGIN))
    monkeypatch.setattr(oidc, "FLOW_SECONDS", -1)
    assert refusal(stranger.get(back)) == (401, "oidc_expired")


def test_person_who_cancels_at_the_provider_is_told_so(olga, stranger):
    address = stranger.post(BEGIN).headers["refresh"].partition("url=")[2]
    back = urlsplit(httpx2.post(address, data={"action": "deny"}).headers["location"])
    state = parse_qs(urlsplit(address).query)["state"][0]
    assert parse_qs(back.query)["error"] == ["access_denied"]
    assert refusal(stranger.get(f"{RETURN}?error=access_denied&state={state}")) == (401, "oidc_refused")


def test_what_is_sealed_for_another_purpose_is_no_flow(stranger, state):
    for text in ("", "{}", "$argon2id$v=19", '{"state": ""}'):
        stranger.cookies = {"tada_flow": state.part(SecretBox).seal(text)}
        assert refusal(stranger.get(f"{RETURN}?state=")) == (401, "oidc_expired")


def test_next_leads_to_no_other_site(olga, stranger):
    for elsewhere in ("https://evil.example", "//evil.example", "/dashboard\\evil"):
        answer = stranger.get(authorise(stranger.post(f"{BEGIN}?next={elsewhere}")))
        assert answer.headers["location"] == "/dashboard"


def test_another_site_can_neither_begin_nor_link(client, olga, provider):
    provider.calls.clear()
    cookie = "; ".join(f"{name}={value}" for name, value in olga.cookies.items())
    for path in (BEGIN, "/dashboard/account/institution", "/dashboard/account/institution/removal"):
        headers = {"Cookie": cookie, "Sec-Fetch-Site": "cross-site"}
        assert client.post(path, headers=headers).json()["code"] == "cross_site"
        assert client.get(path, headers={"Cookie": cookie}).status_code == 405
    assert provider.calls == []


def test_account_is_linked_to_one_person_and_by_the_session_that_began(client, olga, sign_in_browser, state):
    rene = sign_in_browser("rene")
    answer = rene.get(authorise(rene.post("/dashboard/account/institution")))
    assert (answer.status_code, "oidc_taken" in answer.text) == (409, True)
    back = authorise(rene.post("/dashboard/account/institution"), "rene@hospital.example")
    session = olga.cookies["tada_session"]
    mixed = Stranger(client)
    mixed.cookies = rene.cookies | {"tada_session": session}  # the next person at this computer
    assert refusal(mixed.get(back)) == (401, "oidc_expired")
    assert rene.post("/dashboard/sign-out").status_code == 303
    assert rene.get(back).headers["location"].startswith("/dashboard/sign-in?next=")
    with state.database.read() as database:
        assert database.query(Staff).filter_by(name="rene").one().oidc_identity is None


@pytest.mark.both_stores
def test_link_ends_when_its_person_ends_it_is_disabled_or_gets_another_password(client, admin, olga, stranger, state):
    def link():
        assert olga.get(authorise(olga.post("/dashboard/account/institution"))).status_code == 303

    assert olga.post("/dashboard/account/institution/removal").status_code == 303
    assert refusal(sign_in(stranger)) == (401, "oidc_unlinked")
    link()
    assert sign_in(stranger).status_code == 303
    client.patch("/v1/staff/olga", headers=admin, json={"is_disabled": True})
    assert stranger.get("/dashboard").headers["location"] == "/dashboard/sign-in"
    stranger.cookies.clear()
    assert refusal(sign_in(stranger)) == (401, "oidc_unlinked")
    client.patch("/v1/staff/olga", headers=admin, json={"is_disabled": False})
    assert refusal(sign_in(stranger)) == (401, "oidc_unlinked")  # who knew the password may have linked it
    with state.database.write() as session:
        row = session.query(Staff).filter_by(name="olga").one()
        row.oidc_identity = oidc.sha256_hex(f"{state.settings.oidc_issuer}\n{SUBJECT}")
    assert sign_in(stranger).status_code == 303
    client.patch("/v1/staff/olga", headers=admin, json={"password": "staple of another horse"})
    stranger.cookies.clear()
    assert refusal(sign_in(stranger)) == (401, "oidc_unlinked")


def test_same_subject_of_another_issuer_is_somebody_else(olga, stranger, state):
    with state.database.write() as session:
        row = session.query(Staff).filter_by(name="olga").one()
        row.oidc_identity = oidc.sha256_hex(f"https://former.example\n{SUBJECT}")
    assert refusal(sign_in(stranger)) == (401, "oidc_unlinked")


def test_provider_asks_for_the_second_factor_itself(olga, stranger, monkeypatch):
    monkeypatch.setattr(totp, "_step", lambda now: 7)
    page = olga.page("/dashboard/account/totp")
    secret = re.search(r'name="secret" value="([A-Z2-7]{32})"', page)[1]
    olga.post("/dashboard/account/totp", secret=secret, code=code_of(secret, 7))
    assert "Turn them off" in olga.page("/dashboard/account")
    assert sign_in(stranger).status_code == 303


DESCRIPTION = "/.well-known/openid-configuration"


@pytest.mark.parametrize(
    "body",
    [
        b"<html>",
        b"[]",
        b"7",
        b"{}",
        b'{"issuer": "https://evil.example", "authorization_endpoint": "", "token_endpoint": "", "jwks_uri": ""}',
    ],
    ids=["html", "list", "number", "empty", "of another issuer"],
)
def test_provider_whose_description_is_wrong_is_unavailable(stranger, provider, body):
    provider.answers[DESCRIPTION] = body
    answer = stranger.post(BEGIN)
    assert refusal(answer) == (503, "unavailable")
    assert "Your institution&#39;s sign-in does not answer at present." in answer.text


def test_description_without_end_is_not_read_to_its_end(stranger, provider):
    description = httpx2.get(provider.address + DESCRIPTION).content
    provider.answers[DESCRIPTION] = description
    assert stranger.post(BEGIN).status_code == 200
    provider.answers[DESCRIPTION] = description + b" " * oidc.MAX_ANSWER_BYTES
    assert refusal(stranger.post(BEGIN)) == (503, "unavailable")


@pytest.mark.parametrize("path", ["/oauth2/token", "/jwks"])
@pytest.mark.parametrize("body", [b"{}", b'{"keys": 7, "id_token": 7}', b'{"keys": [{}], "id_token": "a.b.c"}'])
def test_broken_answers_open_nothing(olga, stranger, provider, path, body):
    back = authorise(stranger.post(BEGIN))
    provider.answers[path] = body
    assert refusal(stranger.get(back)) == (401, "oidc_refused")


def test_provider_that_is_down_or_asked_by_too_many_is_unavailable(stranger, state, monkeypatch):
    back = authorise(stranger.post(BEGIN))
    monkeypatch.setattr(oidc, "_calls", oidc.threading.BoundedSemaphore(1))
    oidc._calls.acquire()
    assert refusal(stranger.get(back)) == (503, "unavailable")
    oidc._calls.release()
    state.settings = Settings(**state.settings.model_dump() | {"oidc_issuer": "http://127.0.0.1:1"})
    for answer in (stranger.get(back), stranger.post(BEGIN)):
        assert refusal(answer) == (503, "unavailable")


def test_tries_are_limited_by_address(client, olga, stranger, monkeypatch):
    monkeypatch.setattr(signing_in, "WINDOW", timedelta(days=1))
    monkeypatch.setattr(client.app.state.api.part(signing_in.SignInLimits), "_per_minute", 1)
    codes = [sign_in(stranger, f"stranger {number}").status_code for number in range(4)]
    assert codes[-1] == 429


def test_server_without_a_provider_shows_and_does_nothing_of_it(app, client, sign_in_browser, stranger, state):
    state.settings = Settings(data_dir=state.settings.data_dir)
    assert "institution" not in stranger.get("/dashboard/sign-in").text
    for answer in (stranger.post(BEGIN), stranger.get(RETURN)):
        assert refusal(answer) == (404, "not_found")
    assert "institution" not in sign_in_browser(f"ann {uuid.uuid4().hex[:4]}").page("/dashboard/account")


@pytest.mark.parametrize(
    "values",
    [
        {"oidc_issuer": "https://login.example.org"},
        {"oidc_client_id": "tada", "oidc_client_secret": "x"},
        {"oidc_issuer": "http://login.example.org", "oidc_client_id": "tada", "oidc_client_secret": "x"},
        {"oidc_issuer": "http://localhost.evil.example", "oidc_client_id": "tada", "oidc_client_secret": "x"},
    ],
)
def test_provider_that_is_half_set_or_without_tls_is_refused(values):
    with pytest.raises(ValueError, match=r"oidc_issuer|TADA_OIDC_ISSUER"):
        Settings(**values)
