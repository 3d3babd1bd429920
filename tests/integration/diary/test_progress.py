"""Who is behind: each figure of a participant's row, its order, its filters, its file."""

from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.people.models import Device
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, participant_of, set_profile
from tests.integration.records.talking import Speaker

PATH = "/v1/studies/pilot/progress"
WINDOW = {"from": "2026-11-01", "to": "2026-11-10"}


@pytest.fixture
def progress(client, admin):
    def progress(**asked):
        answer = client.get(PATH, headers=admin, params=WINDOW | asked)
        assert answer.status_code == 200, answer.text
        return {row["code"]: row for row in answer.json()["items"]}

    return progress


def label(client, admin, code, **fields):
    assert client.patch(f"/v1/studies/pilot/participants/{code}", headers=admin, json=fields).is_success


@pytest.fixture
def pilot(enrol, state):
    """P1 has begun, P2 has entered nothing, P3 is a good participant."""
    phones = {code: enrol(code) for code in ("P1", "P2", "P3")}
    for day in ("2026-11-04", "2026-11-05", "2026-11-06"):
        add_meal(state, "P1", day, eaten_item(energy_kcal=300.0))
    for number in range(1, 11):
        add_meal(state, "P3", f"2026-11-{number:02}", eaten_item(energy_kcal=2000.0))
        close(phones["P3"], f"2026-11-{number:02}")
    close(phones["P1"], "2026-11-04", "2026-11-05")
    set_profile(state, "P1", sex="female", birth_year=1990, height_cm=170.0, weight_kg=60.0)
    return phones


@pytest.mark.both_stores
def test_every_figure_of_a_row_is_counted_from_what_the_participant_has_sent(client, admin, pilot, state, progress):
    add_meal(state, "P1", "2026-10-01", status="failed")
    add_meal(state, "P1", "2026-11-06", status="queued")
    add_meal(state, "P1", "2026-11-06", eaten_item(None))
    asked_about = str(add_meal(state, "P1", "2026-11-12", eaten_item()))
    Speaker(client, admin, asked_about).say("question", text="What was it?")
    seen = datetime(2026, 11, 13, 9, tzinfo=UTC)
    with state.database.write() as session:
        person = participant_of(session, "P1").id
        session.execute(sa.update(Device).where(Device.participant_id == person).values(last_used_at=seen))
    row = progress()["P1"]
    assert row["last_entry"] == "2026-11-12"
    assert (row["expected_days"], row["complete_days"]) == (10, 2), "their first meal was before the window"
    assert row["open_days"] == ["2026-11-06"]
    assert (row["open_questions"], row["failed_meals"], row["waiting_meals"]) == (1, 1, 1)
    assert datetime.fromisoformat(row["phone_seen_at"]) == seen
    assert (row["plausibility"]["verdict"], row["plausibility"]["days"]) == ("low", 2)
    silent = progress()["P2"]
    assert (silent["last_entry"], silent["expected_days"], silent["open_questions"]) == (None, 0, 0)


def test_days_before_the_start_and_after_the_end_count_in_neither_number(client, admin, pilot, state, progress):
    set_profile(state, "P3", starts_on=datetime(2026, 11, 3, tzinfo=UTC).date())
    assert (progress()["P3"]["complete_days"], progress()["P3"]["expected_days"]) == (8, 8)
    with state.database.write() as session:
        participant_of(session, "P3").withdrawn_at = datetime(2026, 11, 5, 12, tzinfo=UTC)
    assert (progress()["P3"]["complete_days"], progress()["P3"]["expected_days"]) == (3, 3)


def test_those_who_are_most_behind_come_first_and_those_who_left_or_are_excluded_last(
    client, admin, pilot, enrol, state, progress
):
    enrol("P0")
    label(client, admin, "P0", excluded="moved away")
    assert list(progress(order="participant")) == ["P0", "P1", "P2", "P3"]
    assert list(progress()) == ["P2", "P1", "P3", "P0"], "by the last entry"
    assert list(progress(order="complete")) == ["P1", "P2", "P3", "P0"]
    assert list(progress(order="energy")) == ["P1", "P2", "P3", "P0"]
    assert list(progress(order="questions")) == list(progress(order="complete")), "nobody has any"
    add_meal(state, "P3", "2026-11-02", status="failed")
    assert list(progress(order="unmeasured")) == ["P3", "P1", "P2", "P0"]


def test_filters_choose_and_the_file_has_the_same_rows(client, admin, pilot, progress):
    label(client, admin, "P1", arm="low salt", visit="week 4")
    label(client, admin, "P2", arm="low salt", visit="baseline")
    assert list(progress(arm="low salt")) == ["P2", "P1"]
    assert list(progress(arm="low salt", visit="week 4")) == ["P1"]
    assert list(progress(participant=["P3", "P1"])) == ["P1", "P3"]
    asked = WINDOW | {"format": "csv", "arm": "low salt", "order": "last_entry"}
    header, *lines = client.get(PATH, headers=admin, params=asked).text.splitlines()
    assert header.startswith(
        "code,starts_on,arm,visit,excluded,withdrawn_at,created_at,enrolled_at,last_entry,expected_days,"
    )
    assert [line.split(",")[:4] for line in lines] == [
        ["P2", "", "low salt", "baseline"],
        ["P1", "", "low salt", "week 4"],
    ]
    wrong = client.get(PATH, headers=admin, params={"from": "2026-11-02", "to": "2026-11-01"})
    assert (wrong.status_code, wrong.json()["code"]) == (422, "days_reversed")


def test_window_without_days_ends_yesterday(client, admin, pilot, state):
    told = client.get(PATH, headers=admin).json()
    yesterday = datetime.now(UTC).date() - timedelta(days=1)
    assert (told["last_day"], told["first_day"]) == (str(yesterday), str(yesterday - timedelta(days=27)))
    with state.database.read() as session:
        assert session.query(Meal).count() == 13
