"""A participant's days: closed, opened again, nothing eaten; the reviewer's word over theirs; days that come late."""

from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.diary.diary import effective_event
from app.meals.stored.event_models import DayEvent, DiaryDay
from app.meals.stored.meal_time import latest_day
from app.people.models import Participant, Study
from app.people.privacy_models import AuditEvent
from tests.integration.conftest import meal_metadata
from tests.integration.diary.eaten_days import add_meal
from tests.integration.meals.upload.answers import refusal
from tests.support.photographs import pair

DAY = "2026-11-19"
PATH = f"/v1/me/days/{DAY}"
STAFF_PATH = f"/v1/studies/pilot/participants/P001/days/{DAY}"
CLOSED, OPEN = {"status": "closed"}, {"status": "open"}
NOTHING = {"status": "closed", "ate_nothing": True}


def say(phone, body, version, path=PATH):
    return phone.put(path, json=body, headers={"If-Match": f'"{version}"'})


def days_of(phone, **params):
    return phone.get("/v1/me/days", **({"from": "2026-11-01", "to": "2026-11-30"} | params)).json()["items"]


@pytest.fixture
def review(client, admin):
    """A reviewer's word about the day."""

    def review(body, version):
        return client.put(STAFF_PATH, headers=admin | {"If-Match": f'"{version}"'}, json=body)

    return review


def test_closed_day_is_listed_with_its_version_and_decider_for_its_participant_and_staff(enrol, client, admin, state):
    phone, other = enrol("P001"), enrol("P002")
    answer = say(phone, CLOSED, 0)
    assert (answer.status_code, answer.headers["etag"]) == (200, '"1"')
    assert [answer.json()] == days_of(phone)
    day = answer.json()
    assert (day["date"], day["status"], day["ate_nothing"], day["version"]) == (DAY, "closed", False, 1)
    assert (day["decided_by"], day["study_day"], day["meals"]) == ("participant", 1, 0)
    with state.database.read() as session:
        assert session.query(DiaryDay).one().change_seq == session.query(Study).one().change_seq == 1
    path, params = STAFF_PATH.rpartition("/")[0], {"from": DAY, "to": DAY}
    assert client.get(path, headers=admin, params=params).json()["items"] == days_of(phone)
    assert client.get(path.replace("P001", "P999"), headers=admin).status_code == 404
    assert days_of(other) == []
    assert say(other, CLOSED, 0).json()["version"] == 1


def test_closed_day_can_be_reopened_and_all_events_are_kept(phone, state):
    first, again = say(phone, CLOSED, 0), say(phone, CLOSED, 0)  # the response was lost
    assert (again.status_code, again.json()) == (200, first.json())
    answer = say(phone, OPEN, 1)
    assert (answer.json()["status"], answer.json()["version"]) == ("open", 2)
    with state.database.read() as session:
        events = session.scalars(sa.select(DayEvent).order_by(DayEvent.created_at)).all()
        assert [(event.kind, event.layer, event.author) for event in events] == [
            ("closed", "participant", "participant"),
            ("reopened", "participant", "participant"),
        ]
        noted = session.scalars(sa.select(AuditEvent.action).where(AuditEvent.action.like("day.%"))).all()
        assert sorted(noted) == ["day.closed", "day.reopened"]


def test_change_of_another_version_or_without_one_is_refused(phone):
    assert say(phone, CLOSED, 1).status_code == 412
    say(phone, CLOSED, 0)
    answer = say(phone, OPEN, 0)
    assert (*refusal(answer), answer.json()["version"]) == (412, "precondition_failed", 1)
    assert phone.put(PATH, json=CLOSED).status_code == 428
    assert phone.put(PATH, json=OPEN, headers={"If-Match": "*"}).json()["status"] == "open"


def test_nothing_eaten_is_refused_on_a_day_with_meals_unless_they_were_deleted(phone, state):
    assert days_of(phone) == []
    add_meal(state, "P001", DAY)
    day = days_of(phone)[0]
    assert (day["status"], day["version"], day["decided_by"], day["meals"]) == ("open", 0, None, 1)
    answer = say(phone, NOTHING, 0)
    assert (*refusal(answer), answer.json()["meals"]) == (409, "day_has_meals", 1)
    assert say(phone, CLOSED, 0).status_code == 200
    send_and_delete(phone, "2026-11-18")
    assert say(phone, NOTHING, 0, path="/v1/me/days/2026-11-18").json()["ate_nothing"] is True


def send_and_delete(phone, day):
    body = meal_metadata(captured_at=f"{day}T12:30:00+08:00")
    assert phone.post(pair(), body).json()["local_date"] == str(day)
    assert phone.client.delete(f"/v1/meals/{body['id']}", headers=phone.headers).status_code == 200


def test_meal_that_comes_late_marks_the_closed_day_until_it_is_closed_again(phone, state):
    path = "/v1/me/days/2026-11-18"
    assert say(phone, NOTHING, 0, path=path).json()["ate_nothing"] is True
    add_meal(state, "P001", "2026-11-18", delay=timedelta(days=400))  # it overrides the entry
    day = days_of(phone)[0]
    assert (day["status"], day["ate_nothing"], day["meals"], day["meals_after_closing"]) == ("closed", False, 1, 1)
    add_meal(state, "P001", DAY)
    assert say(phone, CLOSED, 0).json()["meals_after_closing"] == 0
    with state.database.write() as session:  # closed a minute after midnight, seen from a phone that was off
        session.execute(sa.update(DiaryDay).values(changed_at=datetime(2026, 11, 20, 0, 1, tzinfo=UTC)))
    add_meal(state, "P001", DAY, delay=timedelta(days=1))
    day = days_of(phone)[1]
    assert (day["status"], day["meals"], day["meals_after_closing"]) == ("closed", 2, 1)
    assert say(phone, CLOSED, 1).json()["meals_after_closing"] == 0


def test_today_of_the_easternmost_zone_may_be_closed_and_no_impossible_day_or_entry_is_taken(phone):
    latest = latest_day(datetime.now(UTC))
    assert say(phone, CLOSED, 0, path=f"/v1/me/days/{latest}").status_code == 200
    for day in (latest + timedelta(days=2), "1999-12-31", "0001-01-01", "9999-12-31"):
        assert refusal(say(phone, CLOSED, 0, path=f"/v1/me/days/{day}")) == (422, "day_impossible"), day
    assert say(phone, CLOSED, 0, path="/v1/me/days/yesterday").status_code == 422
    for body in ({}, {"status": "shut"}, {"status": "open", "ate_nothing": True}, {"status": "closed", "why": "x"}, []):
        assert say(phone, body, 0).status_code == 422, body


def test_reviewers_entry_overrides_earlier_and_later_ones_of_the_participant(phone, review):
    say(phone, CLOSED, 0)
    answer = review(OPEN, 1)
    assert (answer.status_code, answer.json()["status"], answer.json()["decided_by"]) == (200, "open", "reviewer")
    later = say(phone, CLOSED, 2).json()
    assert (later["status"], later["decided_by"], later["version"]) == ("open", "reviewer", 3)
    events = [DayEvent(kind=kind, layer="participant") for kind in ("closed", "ate_nothing")]
    reopened = DayEvent(kind="reopened", layer="reviewer")
    assert effective_event([events[0], reopened, events[1]]) is reopened
    assert effective_event(events) is events[1]


def test_range_that_cannot_be_listed_is_refused_and_open_ends_are_filled_in(phone):
    for params, code in (
        ({"from": "2026-11-03", "to": "2026-11-01"}, "days_reversed"),
        ({"from": "2024-11-01", "to": "2026-11-01"}, "days_too_many"),
        ({"from": "soon"}, "invalid_input"),
    ):
        assert refusal(phone.get("/v1/me/days", **params)) == (422, code)
    for params in ({}, {"from": "0001-01-01"}, {"to": "0001-01-01"}, {"from": "9999-12-31"}):
        assert phone.get("/v1/me/days", **params).status_code == 200, params


def test_meal_before_the_studys_day_start_is_on_the_day_before(enrol, state):
    phone = enrol()
    with state.database.write() as session:
        session.execute(sa.update(Study).values(day_starts_minutes=240))
    body = meal_metadata(captured_at="2026-11-20T01:30:00+08:00")
    assert phone.post(pair(), body).json()["local_date"] == "2026-11-19"
    assert phone.post(pair(), body).status_code == 200  # the same again
    assert days_of(phone)[0]["date"] == "2026-11-19"


def test_day_of_a_withdrawn_participant_cannot_be_changed(phone, state, review):
    say(phone, CLOSED, 0)
    with state.database.write() as session:
        session.execute(sa.update(Participant).values(withdrawn_at=datetime(2026, 11, 20, tzinfo=UTC)))
    assert refusal(review(OPEN, 1)) == (409, "participant_withdrawn")
    assert refusal(say(phone, OPEN, 1)) == (410, "withdrawn")  # its token was looked up before it was revoked
