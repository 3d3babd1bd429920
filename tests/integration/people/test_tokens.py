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


def test_token_is_read_only_unless_created_for_writing(client, olga):
    reader, writer = make(olga), make(olga, scope="write")
    body = {"code": "P1"}
    refused = client.post("/v1/studies/pilot/participants", headers=reader, json=body)
    assert (refused.status_code, refused.json()["code"]) == (403, "token_read_only")
    assert client.get("/v1/studies/pilot", headers=reader).status_code == 200
    assert client.post("/v1/studies/pilot/participants", headers=writer, json=body).status_code == 201


def test_token_for_one_study_reaches_no_other(client, olga):
    token = make(olga, study="pilot", scope="write")
    assert client.get("/v1/studies/pilot", headers=token).status_code == 200
    assert client.get("/v1/studies/other", headers=token).status_code == 404
    assert [row["code"] for row in client.get("/v1/studies", headers=token).json()["items"]] == ["pilot"]


def test_admin_token_for_one_study_has_no_admin_rights(client, admin, olga):
    root = make_staff(client, admin, "root", is_admin=True)
    token = make(root, study="pilot", scope="write")
    assert client.get("/v1/studies/pilot/members", headers=token).status_code == 200
    assert client.get("/v1/studies/other", headers=token).status_code == 404
    assert client.post("/v1/studies", headers=token, json={"code": "x", "name": "x"}).json()["code"] == "admin_only"


def test_token_loses_rights_that_its_creator_loses(client, admin, olga):
    token = make(olga, scope="write")
    client.put("/v1/studies/other/members/olga", headers=admin, json={"role": "reviewer"})
    make_staff(client, admin, "rita", pilot="owner")
    client.delete("/v1/studies/pilot/members/olga", headers=admin)
    assert client.get("/v1/studies/pilot", headers=token).status_code == 404
    assert client.get("/v1/studies/other", headers=token).status_code == 200


def test_token_makes_lists_and_ends_no_tokens(client, olga):
    token = make(olga, scope="write")
    for answer in (
        client.get("/v1/tokens", headers=token),
        client.post("/v1/tokens", headers=token, json={"name": "another"}),
        client.delete(f"/v1/tokens/{olga.get('/v1/tokens').json()['items'][0]['id']}", headers=token),
        client.get("/v1/sessions/current", headers=token),
    ):
        assert (answer.status_code, answer.json()["code"]) == (403, "session_needed")


def test_token_for_a_study_without_a_role_is_refused(olga):
    for study in ("foreign", "nowhere"):
        assert olga.post("/v1/tokens", json={"name": "x", "study": study}).status_code == 404


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


def test_ended_token_opens_nothing_and_is_not_listed(client, olga):
    token = make(olga)
    (listed,) = olga.get("/v1/tokens").json()["items"]
    for _ in range(2):
        assert olga.delete(f"/v1/tokens/{listed['id']}").status_code == 204
    assert client.get("/v1/studies", headers=token).status_code == 401
    assert olga.get("/v1/tokens").json()["items"] == []


def test_token_of_another_person_cannot_be_revoked(client, admin, olga):
    token = make(olga)
    (listed,) = olga.get("/v1/tokens").json()["items"]
    rita = make_staff(client, admin, "rita", pilot="owner")
    assert rita.delete(f"/v1/tokens/{listed['id']}").status_code == 404
    assert rita.get("/v1/tokens").json()["items"] == []
    assert client.get("/v1/studies", headers=token).status_code == 200


@pytest.mark.parametrize("days", [0, 366, -1, 1.5, None])
def test_token_lasts_a_year_at_most(olga, days):
    assert olga.post("/v1/tokens", json={"name": "x", "days": days}).status_code == 422


def test_tokens_of_a_person_are_bounded(olga, monkeypatch):
    monkeypatch.setattr(access_tokens, "MAX_TOKENS", 2)
    make(olga)
    make(olga)
    refused = olga.post("/v1/tokens", json={"name": "one too many"})
    assert (refused.status_code, refused.json()["code"]) == (409, "too_many_tokens")
