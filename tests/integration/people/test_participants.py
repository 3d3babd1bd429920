"""Participants: by code, with a profile that is checked; and the codes that enrol their phones."""

import json
from datetime import UTC, datetime

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


def test_profile_changes_by_key_null_takes_one_away_and_the_first_day_moves_when_it_is_named(owner, participant, state):
    owner.patch(participant, json={"profile": PROFILE, "starts_on": "2026-11-20"})
    changed = owner.patch(participant, json={"profile": {"weight_kg": 60, "activity": None}}).json()
    assert (changed["profile"]["weight_kg"], changed["profile"]["activity"]) == (60.0, None)
    assert changed["profile"]["sex"] == "female"
    assert changed["starts_on"] == "2026-11-20"
    with state.database.read() as session:
        person = session.query(Participant).one()
        event = session.query(AuditEvent).filter_by(action="participant.change").order_by(AuditEvent.id.desc()).first()
        assert person.profile == {"sex": "female", "birth_year": 1990, "height_cm": 170.0, "weight_kg": 60.0}
        assert (event.subject, event.details) == (str(person.alias), {"fields": ["activity", "weight_kg"]})
    assert owner.patch(participant, json={"starts_on": None}).json()["starts_on"] is None


def test_arm_visit_and_exclusion_are_set_kept_and_taken_away_and_stand_in_list_and_file(owner, participant):
    labels = {"arm": "low salt", "visit": "baseline", "excluded": "moved away"}
    assert owner.patch(participant, json=labels).json().items() >= labels.items()
    assert owner.patch(participant, json={"visit": "week 4", "excluded": None}).json()["arm"] == "low salt"
    (row,) = owner.get(PEOPLE).json()["items"]
    assert (row["arm"], row["visit"], row["excluded"]) == ("low salt", "week 4", None)
    header, values = owner.get(f"{PEOPLE}?format=csv").text.splitlines()
    of_file = dict(zip(header.split(","), values.split(","), strict=True))
    assert (of_file["arm"], of_file["visit"], of_file["excluded"]) == ("low salt", "week 4", "")
    for refused in ({"arm": ""}, {"visit": "v" * 65}, {"excluded": "e" * 201}):
        assert owner.patch(participant, json=refused).status_code == 422
    added = owner.post(PEOPLE, json={"code": "P2", "arm": "control"}).json()
    assert (added["arm"], added["visit"]) == ("control", None)


def test_profile_that_cannot_be_is_refused(owner, participant):
    for code, profiles in {
        "profile_impossible": (
            {"sex": "male", "is_pregnant": True},
            {"trimester": 2},
            {"is_pregnant": True, "birth_year": 1930},
            {"is_pregnant": True, "is_lactating": True},
            {"birth_year": 2190},
        ),
        "invalid_input": (
            {"sex": "other"},
            {"weight_kg": 1000},
            {"height_cm": 1.7},
            {"activity": "couch"},
            {"name": "Anna"},
        ),
    }.items():
        for profile in profiles:
            answer = owner.patch(participant, json={"profile": profile})
            assert (answer.status_code, answer.json()["code"]) == (422, code), profile


def test_withdrawn_participant_stays_listed_gets_no_code_and_no_change(owner, participant, state, client):
    def enrol(code):
        return client.post("/v1/enrolments", json={"code": code, "device_name": "x"}).status_code

    codes = [owner.post(f"{participant}/enrolment-codes").json()["code"] for _ in range(2)]
    assert [enrol(code) for code in codes] == [404, 201]  # a new code ends the earlier one
    code = owner.post(f"{participant}/enrolment-codes").json()["code"]
    with state.database.write() as session:
        session.query(Participant).one().withdrawn_at = datetime.now(UTC)
    assert owner.get(PEOPLE).json()["items"][0]["withdrawn_at"] is not None
    for refused in (owner.post(f"{participant}/enrolment-codes"), owner.patch(participant, json={"profile": {}})):
        assert (refused.status_code, refused.json()["code"]) == (409, "participant_withdrawn")
    assert enrol(code) == 404


def test_qr_code_contains_server_and_code_that_enrols(owner, participant, client):
    issued = owner.post(f"{participant}/enrolment-codes")
    body = issued.json()
    assert json.loads(body["qr_text"]) == {"tada": 1, "server": "http://testserver", "code": body["code"]}
    assert body["capture_url"] == f"http://testserver/capture/#code={body['code']}"
    assert body["qr_svg"].startswith("<svg")
    assert body["code"] not in body["qr_svg"]
    assert issued.headers["cache-control"] == "private, no-store"
    answer = owner.post(f"{participant}/enrolment-codes", headers={"Accept": "image/png"})
    assert (answer.status_code, answer.headers["content-type"]) == (201, "image/png")
    code = json.loads(read_qr(answer.content))["code"]  # as another program reads it
    enrolled = client.post("/v1/enrolments", json={"code": code, "device_name": "x", "model": "iPhone 4S"})
    assert enrolled.json()["participant"] == "P1"


def test_answer_is_what_the_caller_accepts_first(owner, participant):
    for accept, media_type in (
        ("image/svg+xml", "image/svg+xml"),
        ("image/png, */*", "image/png"),
        ("*/*", "application/json"),
        ("text/html, application/json", "application/json"),
    ):
        answer = owner.post(f"{participant}/enrolment-codes", headers={"Accept": accept})
        assert answer.headers["content-type"].split(";")[0] == media_type
