"""Sandbox studies: codes without end, data for a day, and nothing of them among the data of other studies."""

import uuid
from datetime import UTC, datetime, timedelta

import pytest

from app.meals.stored.models import Meal
from app.operations.chores import worker_chores
from app.people.access.secret_box import SecretBox
from app.people.models import Device
from app.privacy.erase import Eraser
from app.privacy.retention import erase_sandboxes
from tests.integration.conftest import Phone, meal_metadata
from tests.integration.dashboard.conftest import Browser
from tests.integration.people.people import make_staff
from tests.support.estimates import found_item, save
from tests.support.photographs import pair

SANDBOX = {"code": "try", "name": "Try", "marker": "plain:9x7:11", "sandbox": True}


@pytest.fixture
def enrol_in_sandbox(client, admin):
    """Enrol a phone in a sandbox study by a code; the code's text by `code`."""
    assert client.post("/v1/studies", headers=admin, json=SANDBOX).json()["sandbox"] is True
    client.post("/v1/studies/try/participants", headers=admin, json={"code": "P001"})

    def enrol(code=None):
        code = code or issue_code(client, admin)
        answer = client.post("/v1/enrolments", json={"code": code, "device_name": "phone"})
        return answer, Phone(client, {"Authorization": f"Bearer {answer.json().get('token')}"}), code

    return enrol


def issue_code(client, admin):
    return client.post("/v1/studies/try/participants/P001/enrolment-codes", headers=admin).json()["code"]


@pytest.fixture
def sandbox_phone(enrol_in_sandbox):
    return enrol_in_sandbox()[1]


def test_code_enrols_any_number_of_phones_and_outlives_the_erased_participant_until_another_is_issued(
    enrol_in_sandbox, client, admin
):
    _, first, code = enrol_in_sandbox()
    _, second, _ = enrol_in_sandbox(code)
    assert first.get("/v1/me").json()["participant"] == second.get("/v1/me").json()["participant"] == "P001"
    assert first.get("/v1/me").json()["study"]["sandbox"] is True
    meal = str(uuid.uuid4())
    assert first.post(pair(), id=meal).status_code == 202
    assert client.post("/v1/me/withdrawal", headers=first.headers).status_code == 200
    assert first.get("/v1/me").json()["code"] == "withdrawn"
    _, again, _ = enrol_in_sandbox(code)
    assert again.get("/v1/me").json()["participant"] == "P001"
    assert again.get("/v1/meals").json()["items"] == []
    assert again.post(pair(), id=meal).status_code == 202  # another person's id is free
    issue_code(client, admin)
    assert enrol_in_sandbox(code)[0].status_code == 404


def test_no_study_becomes_a_sandbox_or_ceases_to_be_one(client, admin, enrol_in_sandbox, enrol):
    enrol("P001", "pilot")
    for study in ("try", "pilot"):
        for value in (True, False):
            answer = client.patch(f"/v1/studies/{study}", headers=admin | {"If-Match": '"1"'}, json={"sandbox": value})
            assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input")


def test_sandbox_neither_teaches_other_studies_nor_keeps_who_left_nor_has_releases(client, admin, enrol_in_sandbox):
    for field in ({"shares_index": True}, {"withdrawal_policy": "keep"}):
        answer = client.post("/v1/studies", headers=admin, json=SANDBOX | {"code": "another"} | field)
        assert (answer.status_code, "sandbox" in answer.json()["detail"]) == (422, True)
        answer = client.patch("/v1/studies/try", headers=admin | {"If-Match": '"1"'}, json=field)
        assert answer.status_code == 422
    answer = client.post("/v1/studies/try/releases", headers=admin, json={"name": "one"})
    assert (answer.status_code, answer.json()["code"]) == (409, "sandbox_study")


def test_everything_is_erased_a_day_after_it_came_and_a_worker_does_so_by_itself(
    client, admin, enrol_in_sandbox, enrol, state
):
    _, phone, code = enrol_in_sandbox()
    phone.post(pair())
    kept = enrol("P001", "pilot")
    kept.post(pair())
    eraser, now = state.part(Eraser), datetime.now(UTC)
    assert erase_sandboxes(eraser, now + timedelta(hours=23)) == 0
    assert erase_sandboxes(eraser, now + timedelta(hours=25)) == 1
    assert erase_sandboxes(eraser, now + timedelta(hours=25)) == 0
    with state.database.read() as session:
        assert session.query(Meal).count() == 1
        assert session.query(Device).count() == 1
    assert len(kept.get("/v1/meals").json()["items"]) == 1
    assert phone.get("/v1/me").json()["code"] == "withdrawn"
    _, again, _ = enrol_in_sandbox(code)
    again.post(pair())
    chores = worker_chores(state.database, state.blobs, state.part(SecretBox), state.settings)
    (chore,) = [chore for chore in chores if chore.name == "erase_old_pictures"]
    assert chore.run() == 0
    with state.database.write() as session:
        for device in session.query(Device):
            device.enrolled_at -= timedelta(days=2)
    assert chore.run() == 1
    assert again.get("/v1/me").json()["code"] == "withdrawn"
    assert len(kept.get("/v1/meals").json()["items"]) == 1


def test_lists_over_several_studies_leave_sandboxes_out(client, admin, enrol, sandbox_phone, state):
    of_study = enrol("P002", "pilot")
    for phone in (sandbox_phone, of_study):
        save(state, phone.post(pair(), hints=[{"point": [30, 20], "food": "apple"}]).json()["id"], found_item())
    for path in ("/v1/meals", "/v1/records", "/v1/days", "/fhir/NutritionIntake"):
        rows = "entry" if "fhir" in path else "items"
        listed = client.get(path, headers=admin).json()[rows]
        assert len(listed) == 1, path
        assert "P002" in str(listed)
        assert len(sandbox_phone.get(path).json()[rows]) == 1  # a phone sees its own
        if rows == "items":
            named = client.get(path, headers=admin, params={"study": "try"}).json()[rows]
            assert "P001" in str(named)


def test_asked_refusal_is_given_and_nothing_is_kept_and_one_that_cannot_be_read_is_refused(sandbox_phone):
    meal = str(uuid.uuid4())
    path, body = f"/v1/meals/{meal}", meal_metadata(id=None)
    for status in (503, 429):
        answer = sandbox_phone.put(path, json=body, headers={"Tada-Sandbox": f"status={status} retry_after=3"})
        assert (answer.status_code, answer.headers["retry-after"]) == (status, "3")
        assert answer.json()["retryable"] is True
        assert sandbox_phone.get(path).status_code == 404
    assert sandbox_phone.put(path, json=body).status_code == 202
    metadata = meal_metadata(sandbox="status=503 times=2 meal=marker_not_found")
    answers = [sandbox_phone.post(pair(), metadata) for _ in range(4)]
    assert [answer.status_code for answer in answers] == [503, 503, 202, 200]
    assert answers[2].json()["ignored"] == []
    answer = sandbox_phone.client.get("/v1/me", headers=sandbox_phone.headers | {"Tada-Sandbox": "status=500"})
    assert (answer.status_code, answer.json()["code"]) == (422, "injection_invalid")
    answer = sandbox_phone.post(pair(), sandbox="nothing")
    assert (answer.status_code, answer.json()["code"]) == (422, "injection_invalid")


def test_other_studies_take_no_notice(phone, client, admin):
    header = {"Tada-Sandbox": "status=503"}
    assert client.get("/v1/me", headers=phone.headers | header).status_code == 200
    assert client.get("/v1/studies", headers=admin | header).status_code == 200
    assert client.get("/v1/me", headers=header | {"Authorization": "Bearer none"}).status_code == 401
    assert phone.get("/v1/me").json()["study"]["sandbox"] is False
    answer = phone.post(pair(), sandbox="status=503 meal=marker_not_found")
    assert (answer.status_code, answer.json()["ignored"]) == (202, ["sandbox"])


def test_pages_of_a_sandbox_say_so(client, admin, sandbox_phone, enrol):
    enrol("P001", "pilot")
    make_staff(client, admin, "olga", **{"try": "owner", "pilot": "owner"})
    olga = Browser(client, "olga")
    assert "is a sandbox" in olga.page("/dashboard/studies/try")
    assert "sandbox" not in olga.page("/dashboard/studies/pilot")
    assert olga.page("/dashboard").count("sandbox") == 1
