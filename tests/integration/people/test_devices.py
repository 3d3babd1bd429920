"""Phones: who they are, when they were last used, by which app and clock; and their end."""

import uuid
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import pytest
from sqlalchemy.exc import OperationalError

from app.people.access.caller import DeviceCaller
from app.people.access.last_use import LastUse, clock_skew_seconds
from tests.integration.people.people import bearer, make_staff
from tests.support.photographs import pair

DEVICES = "/v1/studies/pilot/devices"
NOW = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)


def devices(client, admin, **params):
    return client.get(DEVICES, headers=admin, params=params).json()["items"]


def test_me_returns_phone_participant_and_protocol(enrol):
    phone = enrol(expects_after_pair=True, locale="de", day_starts="04:00")
    me = phone.get("/v1/me").json()
    assert (me["participant"], me["study"]["code"], me["study"]["marker"]) == ("P001", "pilot", "plain:9x7:11")
    assert (me["study"]["expects_after_pair"], me["study"]["locale"]) == (True, "de")
    assert (me["study"]["retention_days"], me["study"]["withdrawal_policy"]) == (None, "erase")
    assert (me["study"]["gives_feedback"], me["study"]["day_starts"]) == (False, "04:00")
    assert me["device"]["name"] == "test phone"
    assert me["joined_at"] == me["device"]["enrolled_at"]
    assert enrol().get("/v1/me").json()["joined_at"] == me["joined_at"]  # another phone of the same person


def test_last_use_model_app_version_and_clock_are_noted(enrol, client, admin, state):
    def device():
        state.part(LastUse).settle()
        return devices(client, admin)[0]

    phone = enrol()
    client.get("/v1/me", headers=phone.headers | {"X-App-Version": "v" * 65})
    assert device()["app_version"] is None  # longer than the database keeps
    first = device()["last_used_at"]
    phone.get("/v1/me")
    assert device()["last_used_at"] == first  # noted once in five minutes
    phone.post(pair(), app_version="2.0.1")
    assert device()["app_version"] == "2.0.1"
    code = client.post("/v1/studies/pilot/participants/P001/enrolment-codes", headers=admin).json()["code"]
    body = {"code": code, "device_name": "Anna's", "model": "Pixel 9", "app_version": "1.0"}
    token = client.post("/v1/enrolments", json=body).json()["token"]
    newest = device()
    assert (newest["model"], newest["app_version"], newest["clock_skew_seconds"]) == ("Pixel 9", "1.0", None)
    ahead = format_datetime(datetime.now(UTC) + timedelta(minutes=10), usegmt=True)
    client.get("/v1/me", headers=bearer(token) | {"Date": ahead, "X-App-Version": "1.4.0"})
    newest = device()
    assert newest["app_version"] == "1.4.0"
    assert newest["clock_skew_seconds"] == pytest.approx(600, abs=60)  # whole seconds, and the call takes time
    used = datetime.fromisoformat(newest["last_used_at"])
    assert timedelta(0) <= datetime.now(UTC) - used < timedelta(minutes=1)


def test_database_that_fails_costs_the_note_and_not_the_request(enrol, state, monkeypatch):
    phone = enrol()

    def no_write():
        raise OperationalError("database is locked", None, Exception())

    monkeypatch.setattr(state.database, "write", no_write)
    assert phone.get("/v1/me").status_code == 200
    state.part(LastUse).settle()


def test_writer_that_holds_the_database_does_not_hold_up_the_request(enrol, state):
    phone = enrol()
    with state.database.write() as session:
        session.connection()  # on SQLite nobody else writes now
        assert phone.get("/v1/me").status_code == 200
    state.part(LastUse).settle()


def test_phone_that_signs_out_or_is_revoked_opens_nothing_any_more(enrol, client, admin):
    phone, other = enrol(), enrol()
    assert client.delete("/v1/me/device", headers=phone.headers).status_code == 204
    assert phone.get("/v1/me").status_code == 401
    assert devices(client, admin)[1]["revoked_at"] is not None
    device = other.get("/v1/me").json()["device"]["id"]
    for _ in range(2):
        assert client.delete(f"{DEVICES}/{device}", headers=admin).status_code == 204
    assert other.get("/v1/me").status_code == 401


def test_phone_of_another_study_is_not_found(enrol, client, admin):
    enrol()
    other = enrol(study="other").get("/v1/me").json()["device"]["id"]
    owner = make_staff(client, admin, "olga", pilot="owner")
    for device in (other, uuid.uuid4()):
        assert owner.delete(f"{DEVICES}/{device}").status_code == 404
    assert [row["id"] for row in owner.get(DEVICES).json()["items"]] != [other]


def test_phones_page_the_last_enrolled_first_and_by_participant(enrol, client, admin):
    ids = [enrol(person).get("/v1/me").json()["device"]["id"] for person in ("P1", "P2", "P1")]
    first = client.get(f"{DEVICES}?limit=2", headers=admin).json()
    second = client.get(first["next"], headers=admin).json()
    assert [row["id"] for row in first["items"] + second["items"]] == ids[::-1]
    assert second["next"] is None
    assert [row["id"] for row in devices(client, admin, participant="P1")] == [ids[2], ids[0]]


@pytest.mark.parametrize(
    ("header", "skew"),
    [
        ("Sat, 21 Nov 2026 12:00:30 GMT", 30.0),
        ("Sat, 21 Nov 2026 11:00:00 GMT", -3600.0),
        ("Thu, 01 Jan 1970 00:00:00 GMT", -1795262400.0),
        (None, None),
        ("soon", None),
        ("Sat, 99 Nov 2026 12:00:00 GMT", None),
        ("Sat, 21 Nov 99999 12:00:00 GMT", None),
        ("", None),
    ],
)
def test_clock_skew_is_the_phones_clock_less_the_servers(header, skew):
    assert clock_skew_seconds(header, NOW) == skew


def test_callers_remembered_are_bounded(state, monkeypatch):
    monkeypatch.setattr("app.people.access.last_use.MAX_REMEMBERED", 3)
    uses = LastUse(state.database)
    try:
        for _ in range(10):
            uses.note(DeviceCaller(*[uuid.uuid4() for _ in range(4)]), {})
        assert len(uses._noted) == 3
    finally:
        uses.close()
