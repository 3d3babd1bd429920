"""Web apps of others: which pages a browser lets read answers, and whose tokens they may use."""

import pytest

from app.core.errors import InvalidInputError
from app.people.access import web_origins
from app.people.access.web_origins import origins_of_setting, parse_origin
from tests.integration.people.people import make_staff

OF_SERVER, OF_STUDY, HOSTILE = "https://app.example.org", "https://study.example.org:8443", "https://evil.example"


@pytest.fixture
def settings(settings):
    return settings.model_copy(update={"web_origins": f"{OF_SERVER}, http://localhost:5173"})


@pytest.fixture(autouse=True)
def forget_at_once(monkeypatch):
    """A study's origins count from the next request on."""
    monkeypatch.setattr(web_origins, "KNOWN_SECONDS", 0.0)


@pytest.fixture
def phones(enrol):
    """A phone of a study with a web app of its own, and one of another study."""
    return enrol("P001", "pilot", web_origins=[OF_STUDY]), enrol("P001", "other")


def preflight(client, origin, method="PUT", headers="authorization, content-type, if-match"):
    asked = {"Origin": origin, "Access-Control-Request-Method": method, "Access-Control-Request-Headers": headers}
    return client.options("/v1/meals/6f5c3a52-6d0e-4f7b-8a55-2f0a8de3c9b1", headers=asked)


def may_read(answer, origin):
    assert "origin" in answer.headers.get("vary", "").lower()
    assert answer.headers.get("access-control-allow-credentials") is None
    assert answer.headers.get("access-control-allow-origin") in {origin, None}
    return answer.headers.get("access-control-allow-origin") == origin


def test_preflight_of_an_allowed_origin_is_answered_but_for_headers_and_methods_of_no_use(client, phones):
    for origin in (OF_SERVER, "http://localhost:5173", OF_STUDY):
        answer = preflight(client, origin)
        assert (answer.status_code, may_read(answer, origin)) == (200, True)
        assert {"PUT", "PATCH", "DELETE"} <= set(answer.headers["access-control-allow-methods"].split(", "))
        assert "Authorization" in answer.headers["access-control-allow-headers"]
    assert preflight(client, OF_SERVER, headers="cookie").status_code == 400
    assert preflight(client, OF_SERVER, method="TRACE").status_code == 400


def test_other_origins_get_nothing(client, phones):
    for origin in (
        HOSTILE,
        "null",
        "*",
        "http://app.example.org",
        "https://app.example.org:444",
        "https://app.example.org.evil.example",
        "https://sub.app.example.org",
        "https://study.example.org",
        "https://app.example.org/",
        "",
    ):
        answer = preflight(client, origin)
        assert (answer.status_code, may_read(answer, origin)) == (400, False), origin
        answer = client.get("/v1/me", headers=phones[0].headers | {"Origin": origin})
        assert not may_read(answer, origin)
        assert "access-control-expose-headers" not in answer.headers


def test_app_of_the_server_reads_answers_headers_and_refusals_with_any_token(client, admin, phones):
    for headers in (phones[0].headers, phones[1].headers):
        answer = client.get("/v1/me", headers=headers | {"Origin": OF_SERVER})
        assert (answer.status_code, may_read(answer, OF_SERVER)) == (200, True)
        exposed = set(answer.headers["access-control-expose-headers"].split(", "))
        assert {"ETag", "Retry-After", "Location"} <= exposed
    assert client.get("/v1/studies", headers=admin | {"Origin": OF_SERVER}).status_code == 200
    refused = client.get("/v1/me", headers={"Origin": OF_SERVER})
    assert (refused.status_code, may_read(refused, OF_SERVER)) == (401, True)


def test_app_of_a_study_is_for_its_participants_only(client, admin, phones):
    own, other = phones
    answer = client.get("/v1/me", headers=own.headers | {"Origin": OF_STUDY})
    assert (answer.status_code, may_read(answer, OF_STUDY)) == (200, True)
    for headers in (other.headers, admin, make_staff(client, admin, "olga", pilot="owner").headers):
        answer = client.get("/v1/me", headers={**headers, "Origin": OF_STUDY})
        assert (answer.status_code, answer.json()["code"]) == (403, "origin_not_allowed")
        assert may_read(answer, OF_STUDY)  # so that the app's author sees why


def test_change_of_a_studys_origins_holds_at_once(client, admin, phones):
    body = client.patch("/v1/studies/pilot", headers=admin | {"If-Match": "*"}, json={"web_origins": []}).json()
    assert body["web_origins"] == []
    assert preflight(client, OF_STUDY).status_code == 400


def test_study_keeps_origins_as_browsers_write_them(client, admin):
    origins = ["HTTPS://App.Example.org:443", "http://localhost:5173", "https://app.example.org"]
    made = client.post("/v1/studies", headers=admin, json={"code": "s", "name": "S", "web_origins": origins})
    assert made.json()["web_origins"] == ["http://localhost:5173", "https://app.example.org"]
    refused = client.post("/v1/studies", headers=admin, json={"code": "t", "name": "T", "web_origins": ["*"]})
    assert (refused.status_code, refused.json()["code"]) == (422, "origin_invalid")


def test_what_is_no_origin_or_not_safe_is_refused():
    hosts = (
        "app.example.org/",
        "app.example.org/app",
        "me@app.example.org",
        "a b",
        "app.example.org:0",
        "*.example.org",
    )
    hosts += ("app.example.org:65536", "app.example.org?x", "bücher.example", "app.example.org\nhttps://evil.example")
    bare = ("*", "null", "", "app.example.org", "ftp://app.example.org", "http://app.example.org")
    for text in (*bare, "http://localhost.evil.example", *(f"https://{host}" for host in hosts)):
        with pytest.raises(InvalidInputError) as refused:
            parse_origin(text)
        assert refused.value.code == "origin_invalid"


def test_wrong_setting_is_named():
    with pytest.raises(InvalidInputError, match="TADA_WEB_ORIGINS") as refused:
        origins_of_setting("https://app.example.org, *")
    assert refused.value.code == "settings_invalid"
    assert origins_of_setting(None) == origins_of_setting(" ") == frozenset()


def test_pages_of_the_server_itself_and_the_dashboard_are_not_concerned(client, phones):
    own = str(client.base_url)
    answer = client.get("/v1/me", headers=phones[0].headers | {"Origin": own})
    assert (answer.status_code, may_read(answer, own)) == (200, False)
    answer = client.get("/dashboard/sign-in", headers={"Origin": OF_SERVER})
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.both_stores
def test_origins_of_studies_are_read_once_while_they_are_known(client, phones, monkeypatch):
    reads = []
    monkeypatch.setattr(web_origins, "KNOWN_SECONDS", 3600.0)
    monkeypatch.setattr(web_origins.people, "web_origins", lambda _session: reads.append(1) or [])
    for _ in range(20):
        assert not may_read(preflight(client, HOSTILE), HOSTILE)
    assert len(reads) == 1
