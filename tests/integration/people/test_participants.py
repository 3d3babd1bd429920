"""Participants: by code, with a profile that is checked; and the codes that enrol their phones."""

import json
from datetime import UTC, date, datetime

import pytest

from app.people.models import Participant
from app.people.privacy_models import AuditEvent
from tests.integration.people.people import make_staff
from tests.support.qr_codes import read_qr

PROFILE = {"sex": "female", "birth_year": 1990, "height_cm": 170.0, "weight_kg": 62.5, "activity": "active"}
PEOPLE = "/v1/studies/pilot/participants"


@pytest.fixture
def owner(client, admin):
    client.post("/v1/studies", headers=admin, json={"code": "pilot", "name": "Pilot"})
    return make_staff(client, admin, "olga", pilot="owner")


@pytest.fixture
def participant(owner):
    owner.post(PEOPLE, json={"code": "P1"})
    return f"{PEOPLE}/P1"


def withdraw(state):
    with state.database.write() as session:
        session.query(Participant).one().withdrawn_at = datetime.now(UTC)


def test_participant_is_created_with_profile_and_first_day(owner):
    body = {"code": "P1", "starts_on": "2026-11-20", "profile": PROFILE}
    made = owner.post(PEOPLE, json=body)
    assert (made.status_code, made.headers["location"]) == (201, f"{PEOPLE}/P1")
    found = owner.get(f"{PEOPLE}/P1").json()
    assert found == made.json()
    assert found["starts_on"] == "2026-11-20"
    assert {key: value for key, value in found["profile"].items() if value is not None} == PROFILE


def test_profile_changes_by_key_and_null_takes_one_away(owner, participant, state):
    owner.patch(participant, json={"profile": PROFILE})
    changed = owner.patch(participant, json={"profile": {"weight_kg": 60, "activity": None}}).json()
    assert (changed["profile"]["weight_kg"], changed["profile"]["activity"]) == (60.0, None)
    assert changed["profile"]["sex"] == "female"
    assert changed["starts_on"] is None
    with state.database.read() as session:
        person = session.query(Participant).one()
        event = session.query(AuditEvent).filter_by(action="participant.change").order_by(AuditEvent.id.desc()).first()
        assert person.profile == {"sex": "female", "birth_year": 1990, "height_cm": 170.0, "weight_kg": 60.0}
        assert (event.subject, event.details) == (str(person.alias), {"fields": ["activity", "weight_kg"]})


def test_first_day_moves_only_when_it_is_named(owner, participant, state):
    owner.patch(participant, json={"starts_on": "2026-11-20"})
    owner.patch(participant, json={"profile": {"sex": "male"}})
    with state.database.read() as session:
        assert session.query(Participant).one().starts_on == date(2026, 11, 20)
    assert owner.patch(participant, json={"starts_on": None}).json()["starts_on"] is None


@pytest.mark.parametrize(
    ("profile", "code"),
    [
        ({"sex": "male", "is_pregnant": True}, "profile_impossible"),
        ({"trimester": 2}, "profile_impossible"),
        ({"is_pregnant": True, "birth_year": 1930}, "profile_impossible"),
        ({"is_pregnant": True, "is_lactating": True}, "profile_impossible"),
        ({"birth_year": 2190}, "profile_impossible"),
        ({"sex": "other"}, "invalid_input"),
        ({"weight_kg": 1000}, "invalid_input"),
        ({"height_cm": 1.7}, "invalid_input"),
        ({"activity": "couch"}, "invalid_input"),
        ({"name": "Anna"}, "invalid_input"),
    ],
    ids=str,
)
def test_profile_that_cannot_be_is_refused(owner, participant, profile, code):
    answer = owner.patch(participant, json={"profile": profile})
    assert (answer.status_code, answer.json()["code"]) == (422, code)


def test_participants_page_by_code_without_their_profiles(owner):
    for code in ("P3", "P1", "P2"):
        owner.post(PEOPLE, json={"code": code, "profile": PROFILE})
    first = owner.get(f"{PEOPLE}?limit=2").json()
    assert [row["code"] for row in first["items"]] == ["P1", "P2"]
    assert "profile" not in first["items"][0]
    assert [row["code"] for row in owner.get(first["next"]).json()["items"]] == ["P3"]


def test_withdrawn_participant_stays_listed_gets_no_code_and_no_change(owner, participant, state, client):
    code = owner.post(f"{participant}/enrolment-codes").json()["code"]
    withdraw(state)
    assert owner.get(PEOPLE).json()["items"][0]["withdrawn_at"] is not None
    for refused in (owner.post(f"{participant}/enrolment-codes"), owner.patch(participant, json={"profile": {}})):
        assert (refused.status_code, refused.json()["code"]) == (409, "participant_withdrawn")
    assert client.post("/v1/enrolments", json={"code": code, "device_name": "x"}).status_code == 404


def test_new_code_ends_the_earlier_one(owner, participant, client):
    first, second = (owner.post(f"{participant}/enrolment-codes").json()["code"] for _ in range(2))
    answers = [client.post("/v1/enrolments", json={"code": code, "device_name": "x"}) for code in (first, second)]
    assert [answer.status_code for answer in answers] == [404, 201]


def test_qr_code_contains_server_and_code(owner, participant):
    issued = owner.post(f"{participant}/enrolment-codes")
    body = issued.json()
    assert json.loads(body["qr_text"]) == {"tada": 1, "server": "http://testserver", "code": body["code"]}
    assert body["capture_url"] == f"http://testserver/capture/#code={body['code']}"
    assert body["qr_svg"].startswith("<svg")
    assert body["code"] not in body["qr_svg"]
    assert issued.headers["cache-control"] == "private, no-store"


def test_png_is_read_back_by_another_program_and_its_code_enrols(owner, participant, client):
    answer = owner.post(f"{participant}/enrolment-codes", headers={"Accept": "image/png"})
    assert (answer.status_code, answer.headers["content-type"]) == (201, "image/png")
    text = read_qr(answer.content)
    enrolled = client.post(
        "/v1/enrolments", json={"code": json.loads(text)["code"], "device_name": "x", "model": "iPhone 4S"}
    )
    assert enrolled.json()["participant"] == "P1"


@pytest.mark.parametrize(
    ("accept", "media_type"),
    [
        ("image/svg+xml", "image/svg+xml"),
        ("image/png, */*", "image/png"),
        ("*/*", "application/json"),
        ("text/html, application/json", "application/json"),
    ],
)
def test_answer_is_what_the_caller_accepts_first(owner, participant, accept, media_type):
    answer = owner.post(f"{participant}/enrolment-codes", headers={"Accept": accept})
    assert answer.headers["content-type"].split(";")[0] == media_type
