"""Personal tokens: never more than their maker may do, shown once, gone when they are ended."""

from datetime import UTC, datetime, timedelta

import pytest

from app.people.access import access_tokens
from app.people.access.last_use import LastUse
from tests.integration.people.people import bearer, make_staff


@pytest.fixture
def olga(client, admin):
    for code in ("pilot", "other", "foreign"):
        client.post("/v1/studies", headers=admin, json={"code": code, "name": code})
    return make_staff(client, admin, "olga", pilot="owner", other="viewer")


def make(person, **body):
    answer = person.post("/v1/tokens", json={"name": "script"} | body)
    assert answer.status_code == 201, answer.text
    return bearer(answer.json()["token"])


def test_token_for_one_study_reaches_no_other_and_has_no_admin_rights(client, admin, olga):
    for person in (olga, make_staff(client, admin, "root", is_admin=True)):
        token = make(person, study="pilot", scope="write")
        assert client.get("/v1/studies/pilot/members", headers=token).status_code == 200
        assert client.get("/v1/studies/other", headers=token).status_code == 404
        assert [row["code"] for row in client.get("/v1/studies", headers=token).json()["items"]] == ["pilot"]
    assert client.post("/v1/studies", headers=token, json={"code": "x", "name": "x"}).json()["code"] == "admin_only"
    for study in ("foreign", "nowhere"):  # where she has no role
        assert olga.post("/v1/tokens", json={"name": "x", "study": study}).status_code == 404


def test_token_loses_rights_that_its_creator_loses(client, admin, olga):
    token = make(olga, scope="write")
    client.put("/v1/studies/other/members/olga", headers=admin, json={"role": "reviewer"})
    make_staff(client, admin, "rita", pilot="owner")
    client.delete("/v1/studies/pilot/members/olga", headers=admin)
    assert client.get("/v1/studies/pilot", headers=token).status_code == 404
    assert client.get("/v1/studies/other", headers=token).status_code == 200


def test_tokens_are_listed_with_last_use_and_without_secrets(client, olga, state):
    token = make(olga, study="pilot", days=30)
    client.get("/v1/studies", headers=token)
    state.part(LastUse).settle()
    (listed,) = olga.get("/v1/tokens").json()["items"]
    assert "token" not in listed
    assert (listed["name"], listed["scope"], listed["study"]) == ("script", "read", "pilot")
    ends = datetime.fromisoformat(listed["expires_at"]) - datetime.now(UTC)
    assert timedelta(days=29, hours=23) < ends <= timedelta(days=30)
    assert datetime.now(UTC) - datetime.fromisoformat(listed["last_used_at"]) < timedelta(minutes=1)


def test_token_is_revoked_by_its_owner_only_and_opens_nothing_then(client, admin, olga):
    token = make(olga)
    (listed,) = olga.get("/v1/tokens").json()["items"]
    rita = make_staff(client, admin, "rita", pilot="owner")
    assert rita.delete(f"/v1/tokens/{listed['id']}").status_code == 404
    assert rita.get("/v1/tokens").json()["items"] == []
    assert client.get("/v1/studies", headers=token).status_code == 200
    for _ in range(2):
        assert olga.delete(f"/v1/tokens/{listed['id']}").status_code == 204
    assert client.get("/v1/studies", headers=token).status_code == 401
    assert olga.get("/v1/tokens").json()["items"] == []


def test_tokens_of_a_person_are_bounded_and_last_a_year_at_most(olga, monkeypatch):
    for days in (0, 366, -1, 1.5, None):
        assert olga.post("/v1/tokens", json={"name": "x", "days": days}).status_code == 422
    monkeypatch.setattr(access_tokens, "MAX_TOKENS", 2)
    make(olga)
    make(olga, days=365)
    refused = olga.post("/v1/tokens", json={"name": "one too many"})
    assert (refused.status_code, refused.json()["code"]) == (409, "too_many_tokens")
