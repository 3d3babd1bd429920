"""Staff: made by admins, members of studies by owners; the last admin and the last owner stay."""

import pytest

from tests.integration.people.people import PASSWORD, bearer, make_staff, sign_in
from tests.integration.records.at_once import at_once


@pytest.fixture
def study(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "Pilot"})
    return "/v1/studies/pilot"


def test_admin_creates_staff_who_can_sign_in_once_they_have_a_password(client, admin):
    made = client.post("/v1/staff", headers=admin, json={"name": "olga", "password": PASSWORD})
    assert made.status_code == 201
    body = made.json()
    assert (body["name"], body["is_admin"], body["has_password"], body["disabled_at"]) == ("olga", False, True, None)
    assert client.get("/v1/staff/olga", headers=admin).json() == body
    assert sign_in(client, "olga").status_code == 201
    client.post("/v1/staff", headers=admin, json={"name": "rita"})
    assert sign_in(client, "rita", "").json()["code"] == "sign_in_failed"
    client.patch("/v1/staff/rita", headers=admin, json={"password": PASSWORD})
    assert sign_in(client, "rita").status_code == 201


def test_unicode_forms_of_a_name_are_equal(client, admin):
    client.post("/v1/staff", headers=admin, json={"name": "Ren\u00e9"})
    again = client.post("/v1/staff", headers=admin, json={"name": " Rene\u0301 "})
    assert (again.status_code, again.json()["code"]) == (409, "staff_exists")
    assert client.get("/v1/staff/Rene\u0301", headers=admin).status_code == 200


def test_name_unfit_for_urls_is_refused(client, admin):
    for name in ("olga@example.org", "a/b", "..", " ", "x" * 101, "a\nb", "<b>", "a?b"):
        answer = client.post("/v1/staff", headers=admin, json={"name": name})
        assert (answer.status_code, answer.json()["code"]) == (422, "staff_name_invalid"), name


def test_weak_common_or_overlong_password_is_refused(client, admin):
    common = ("password1234", "Passw0rd2026!", "qwertyuiop12", "123456789012", "iloveyou1234", "olga.olga.olga")
    for password in ("short pass", "x" * 201, "aaaaaaaaaaaaaa", *common):
        answer = client.post("/v1/staff", headers=admin, json={"name": "olga", "password": password})
        assert (answer.status_code, answer.json()["code"]) == (422, "password_refused"), password
        assert password not in answer.text
    body = {"name": "olga-petrova", "password": "OLGA-Petrova"}
    assert client.post("/v1/staff", headers=admin, json=body).json()["code"] == "password_refused"
    for name in ("olga", "olga-petrova"):
        assert client.get(f"/v1/staff/{name}", headers=admin).status_code == 404
    make_staff(client, admin, "olga")
    changed = client.patch("/v1/staff/olga", headers=admin, json={"password": common[0]})
    assert (changed.status_code, changed.json()["code"]) == (422, "password_refused")
    assert sign_in(client, "olga").status_code == 201


def test_disabling_ends_sessions_and_tokens_for_good(client, admin, study):
    olga = make_staff(client, admin, "olga", pilot="owner")
    token = olga.post("/v1/tokens", json={"name": "script"}).json()["token"]
    assert client.patch("/v1/staff/olga", headers=admin, json={"is_disabled": True}).json()["disabled_at"]
    client.patch("/v1/staff/olga", headers=admin, json={"is_disabled": False})
    assert olga.get(study).status_code == 401
    assert client.get(study, headers=bearer(token)).status_code == 401
    assert sign_in(client, "olga").status_code == 201


def test_last_admin_cannot_be_disabled_or_lose_the_role(client, admin):
    for change in ({"is_disabled": True}, {"is_admin": False}):
        answer = client.patch("/v1/staff/admin", headers=admin, json=change)
        assert (answer.status_code, answer.json()["code"]) == (409, "last_admin")
    make_staff(client, admin, "second", is_admin=True)
    client.patch("/v1/staff/second", headers=admin, json={"is_disabled": True})
    assert client.patch("/v1/staff/admin", headers=admin, json={"is_disabled": True}).status_code == 409
    client.patch("/v1/staff/second", headers=admin, json={"is_disabled": False})
    assert client.patch("/v1/staff/admin", headers=admin, json={"is_disabled": True}).status_code == 200
    assert client.get("/v1/staff", headers=admin).status_code == 401


def test_staff_page_by_name_and_unknown_ones_are_404(client, admin):
    for name in ("c", "b"):
        client.post("/v1/staff", headers=admin, json={"name": name})
    first = client.get("/v1/staff?limit=2", headers=admin).json()
    assert [row["name"] for row in first["items"]] == ["admin", "b"]
    assert [row["name"] for row in client.get(first["next"], headers=admin).json()["items"]] == ["c"]
    assert client.get("/v1/staff/nobody", headers=admin).status_code == 404
    assert client.patch("/v1/staff/nobody", headers=admin, json={}).status_code == 404


@pytest.mark.both_stores
def test_owner_gives_changes_and_removes_a_role(client, admin, study):
    olga, rita = make_staff(client, admin, "olga", pilot="owner"), make_staff(client, admin, "rita")
    assert rita.get(study).status_code == 404
    assert olga.put(f"{study}/members/rita", json={"role": "viewer"}).json()["role"] == "viewer"
    assert rita.get(study).status_code == 200
    assert rita.post(f"{study}/participants", json={"code": "P"}).json()["code"] == "role_too_low"
    olga.put(f"{study}/members/rita", json={"role": "owner"})
    assert rita.post(f"{study}/participants", json={"code": "P"}).status_code == 201
    members = rita.get(f"{study}/members").json()["items"]
    assert [(row["name"], row["role"]) for row in members] == [("olga", "owner"), ("rita", "owner")]
    assert rita.delete(f"{study}/members/olga").status_code == 204
    assert olga.get(study).status_code == 404


def test_last_owner_cannot_be_removed_or_lose_the_role(client, admin, study):
    olga = make_staff(client, admin, "olga", pilot="owner")
    make_staff(client, admin, "rita", pilot="owner")
    client.patch("/v1/staff/rita", headers=admin, json={"is_disabled": True})  # one who cannot act is no owner left
    member = f"{study}/members/olga"
    for answer in (olga.delete(member), olga.put(member, json={"role": "viewer"})):
        assert (answer.status_code, answer.json()["code"]) == (409, "last_owner")
    assert olga.put(f"{study}/members/olga", json={"role": "owner"}).status_code == 200


def test_unknown_staff_cannot_become_a_member(client, admin, study):
    make_staff(client, admin, "gone")
    client.patch("/v1/staff/gone", headers=admin, json={"is_disabled": True})
    for name in ("nobody", "gone"):
        assert client.put(f"{study}/members/{name}", headers=admin, json={"role": "owner"}).status_code == 404
    assert client.delete(f"{study}/members/nobody", headers=admin).status_code == 404
    assert client.delete(f"{study}/members/admin", headers=admin).status_code == 404  # no member, though an admin


@pytest.mark.both_stores
def test_two_admins_who_disable_each_other_leave_one_admin(client, admin):
    second = make_staff(client, admin, "second", is_admin=True)
    answers = at_once(
        lambda: client.patch("/v1/staff/second", headers=admin, json={"is_disabled": True}),
        lambda: second.patch("/v1/staff/admin", json={"is_disabled": True}),
    )
    statuses = sorted(answer.status_code for answer in answers)
    assert statuses[0] == 200
    assert statuses[1] in (401, 409)  # shut out before the call, or the last one by then


@pytest.mark.both_stores
def test_two_owners_who_remove_each_other_leave_one_owner(client, admin, study):
    olga, rita = make_staff(client, admin, "olga", pilot="owner"), make_staff(client, admin, "rita", pilot="owner")
    answers = at_once(
        lambda: olga.delete(f"{study}/members/rita"),
        lambda: rita.delete(f"{study}/members/olga"),
    )
    assert sum(answer.status_code == 204 for answer in answers) == 1
    assert len(client.get(f"{study}/members", headers=admin).json()["items"]) == 1


@pytest.mark.both_stores
def test_second_of_two_concurrent_creations_of_a_name_conflicts(client, admin):
    answers = at_once(*[lambda: client.post("/v1/staff", headers=admin, json={"name": "olga"})] * 4)
    assert sorted(answer.status_code for answer in answers) == [201, 409, 409, 409]
