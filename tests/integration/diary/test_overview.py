"""A study's overview: figures with known truth, those who are silent, each table as CSV with the rows that JSON has."""

import csv
import io
import statistics
import uuid
from datetime import UTC, date, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.diary.api import ROWS
from app.diary.study_overview import study_overview
from app.meals.stored.models import Meal
from app.people.access.caller import StaffCaller
from app.people.models import Participant, Study
from app.people.privacy_models import AuditEvent
from tests.integration.diary.eaten_days import add_meal, close, eaten_item, set_profile
from tests.integration.meals.upload.answers import refusal

DAY_PATH = "/v1/studies/pilot/overview"


def overview(client, admin, **params):
    answer = client.get(DAY_PATH, headers=admin, params=params)
    assert answer.status_code == 200, answer.text
    return answer.json()


def known(kcal, **columns):
    return eaten_item(100.0, energy_kcal=kcal, **columns)


@pytest.fixture
def eaten(enrol, state):
    """Two people. The first: a whole day, one of nothing, one left open, one late; the second begins on the 3rd."""
    one, two = enrol("P001"), enrol("P002")
    add_meal(state, "P001", "2026-11-01", known(1500.0, protein_g=50.0), hour=8)
    add_meal(state, "P001", "2026-11-01", known(700.0, protein_g=None), hour=18, status="confirmed")
    close(one, "2026-11-01")
    close(one, "2026-11-02", ate_nothing=True)
    add_meal(state, "P001", "2026-11-03", known(900.0))
    add_meal(state, "P001", "2026-11-05", status="failed", delay=timedelta(hours=30))
    close(one, "2026-11-05")
    add_meal(state, "P002", "2026-11-03", known(3000.0, protein_g=10.0), delay=timedelta(hours=25))
    close(two, "2026-11-03")
    with state.database.write() as session:
        failed = session.scalars(sa.select(Meal).where(Meal.status == "failed")).one()
        failed.failure_code = "marker_not_found"
    return one


@pytest.mark.usefixtures("eaten")
def test_window_lists_each_day_with_silent_participants(client, admin):
    found = overview(client, admin)
    assert (found["first_day"], found["last_day"], len(found["days"])) == ("2026-10-09", "2026-11-05", 28)
    days = {day["local_date"]: day for day in found["days"]}
    rows = [
        [day[name] for name in ("expected", "told", "silent", "closed", "ate_nothing", "whole", "meals", "late_meals")]
        for day in (days[f"2026-11-0{n}"] for n in range(1, 6))
    ]
    assert rows == [
        [1, 1, 0, 1, 0, 1, 2, 0],
        [1, 1, 0, 1, 1, 1, 0, 0],
        [2, 2, 0, 1, 0, 1, 2, 1],
        [2, 0, 2, 0, 0, 0, 0, 0],
        [2, 1, 1, 1, 0, 0, 1, 1],
    ]
    assert [(day["told_closed"], day["told_open"]) for day in found["days"][-5:]] == [
        (1, 0), (1, 0), (1, 1), (0, 0), (1, 0)
    ]  # fmt: skip
    assert [day["late_share"] for day in found["days"][-5:]] == [0.0, None, 0.5, None, 1.0]
    delays = [day["median_delay_seconds"] for day in found["days"][-5:]]
    assert delays == [pytest.approx(300), None, pytest.approx((300 + 25 * 3600) / 2), None, pytest.approx(30 * 3600)]
    assert [days[f"2026-11-0{n}"]["whole_energy_kcal"] for n in range(1, 6)] == [2200.0, 0.0, 3000.0, None, None]
    assert (days["2026-11-03"]["open_days"], days["2026-11-03"]["open_energy_kcal"]) == (1, 900.0)
    assert days["2026-10-31"] | {"local_date": None} == days["2026-10-09"] | {"local_date": None}
    assert (days["2026-10-31"]["expected"], days["2026-10-31"]["whole_energy_kcal"]) == (0, None)
    told = found["completeness"]
    assert told.pop("median_delay_seconds") == pytest.approx(300.0, abs=0.01)
    assert told == {"expected": 8, "told": 5, "silent": 3, "closed": 4, "whole": 3, "meals": 5, "late_meals": 2}
    assert found["participants"] == {"everybody": 2, "active": 2, "withdrawn": 0, "erased": 0}


@pytest.mark.usefixtures("eaten")
def test_days_of_participants_and_bins_of_nutrients_add_up_to_those_of_the_study(client, admin):
    found = overview(client, admin)
    for day in found["days"]:
        rows = [row for row in found["person_days"] if row["local_date"] == day["local_date"]]
        assert sum(row["meals"] for row in rows) == day["meals"]
        expected = [row for row in rows if row["expected"]]
        assert len(expected) == day["expected"]
        assert sum(row["closed"] for row in expected) == day["told_closed"]
        assert sum(bool(row["meals"]) and not row["closed"] for row in expected) == day["told_open"]
        assert sum(not row["meals"] and not row["closed"] for row in expected) == day["silent"]
    assert {row["participant"] for row in found["person_days"]} == {"P001", "P002"}
    assert overview(client, admin, **{"from": "2026-10-01", "to": "2026-11-05"})["person_days"] == [], "36 days"
    nutrients = {row["component"]: row for row in found["nutrients"]}
    energy, protein = nutrients["energy_kcal"], nutrients["protein_g"]
    assert (energy["days"], energy["mean"], energy["median"]) == (3, pytest.approx(5200.0 / 3), 2200.0)
    assert energy["sd"] == pytest.approx(1553.49, abs=0.01)
    assert energy["sd_between_persons"] == pytest.approx(statistics.stdev([2200.0 / 2, 3000.0]))
    assert protein["sd_between_persons"] == pytest.approx(statistics.stdev([0.0, 10.0]))
    assert (protein["days"], protein["mean"], protein["maximum"]) == (2, 5.0, 10.0)  # half of one day's is unknown
    for component, row in nutrients.items():
        bins = [each for each in found["histograms"] if each["component"] == component]
        assert row["days"] == sum(each["days"] for each in bins) + row["days_below_bins"] + row["days_above_bins"]


@pytest.mark.usefixtures("eaten")
def test_statuses_are_of_the_window_and_waiting_meals_of_the_study(client, admin):
    found = overview(client, admin, **{"from": "2026-11-01", "to": "2026-11-03"})
    meals = {row["status"]: row["meals"] for row in found["statuses"]}
    assert meals == {"receiving": 0, "queued": 0, "processing": 0, "estimated": 3, "needs_review": 0, "failed": 0,
                     "confirmed": 1}  # fmt: skip
    waiting = {row["status"]: row["meals"] for row in found["waiting"]}
    assert waiting == {"receiving": 0, "queued": 0, "processing": 0, "needs_review": 0, "failed": 1,
                       "needs_look": 0, "after_awaited": 0, "after_failed": 0}  # fmt: skip
    assert found["failures"] == [{"failure_code": "marker_not_found", "meals": 1}]


def test_pending_and_failed_after_meal_pairs_are_counted_for_meals_of_any_status(enrol, state, client, admin):
    enrol("P001")
    due = datetime(2026, 11, 1, 16, tzinfo=UTC)
    for after_status, due_at in ((None, due), ("queued", due), (None, None), ("failed", due), ("estimated", None)):
        meal_id = add_meal(state, "P001", "2026-11-01", status="confirmed")
        with state.database.write() as session:
            meal = session.scalars(sa.select(Meal).where(Meal.client_id == meal_id)).one()
            meal.after_status, meal.after_due_at = after_status, due_at
    waiting = {row["status"]: row["meals"] for row in overview(client, admin)["waiting"]}
    assert (waiting["after_awaited"], waiting["after_failed"]) == (2, 1)


def test_participant_is_expected_from_their_start_until_they_left(enrol, state, client, admin):
    enrol("P001")
    set_profile(state, starts_on=date(2026, 11, 3))
    add_meal(state, "P001", "2026-11-02", known(500.0))  # before their start
    add_meal(state, "P001", "2026-11-04", known(500.0))
    with state.database.write() as session:
        session.scalars(sa.select(Participant)).one().withdrawn_at = datetime(2026, 11, 5, 9, tzinfo=UTC)
    found = overview(client, admin, **{"from": "2026-11-01", "to": "2026-11-07"})
    assert [(day["expected"], day["told"], day["silent"]) for day in found["days"]] == [
        (0, 0, 0), (0, 0, 0), (1, 0, 1), (1, 1, 0), (1, 0, 1), (0, 0, 0), (0, 0, 0)
    ]  # fmt: skip
    assert found["participants"] == {"everybody": 1, "active": 1, "withdrawn": 1, "erased": 0}
    assert [(row["local_date"][-2:], row["expected"], row["meals"]) for row in found["person_days"]] == [
        ("02", False, 1), ("03", True, 0), ("04", True, 1), ("05", True, 0)
    ]  # fmt: skip


@pytest.mark.usefixtures("eaten")
def test_no_participant_is_expected_on_a_future_day(state):
    """A phone whose clock is ahead: its meals are there, and no day has more who told than were expected."""
    caller, day = StaffCaller(uuid.uuid4(), "admin", True, uuid.uuid4()), date(2026, 11, 5)
    before = datetime(2026, 11, 2, tzinfo=UTC)
    found = study_overview(state.database, caller, "pilot", first_day=day - timedelta(days=4), last_day=day, now=before)
    told = [(each.expected, each.told, each.told_closed, each.meals) for each in found.days]
    assert told == [(1, 1, 1, 2), (1, 1, 1, 0), (0, 0, 0, 2), (0, 0, 0, 0), (0, 0, 0, 1)]
    assert (found.completeness.expected, found.completeness.told, found.completeness.meals) == (2, 2, 5)


def test_places_are_shown_only_if_the_study_keeps_them(enrol, state, client, admin):
    enrol("P001", location_policy="keep")
    for day, latitude in (("2026-11-01", 48.20849), ("2026-11-02", -33.9)):
        meal_id = add_meal(state, "P001", day)
        with state.database.write() as session:
            meal = session.scalars(sa.select(Meal).where(Meal.client_id == meal_id)).one()
            meal.details = {"location": {"latitude": latitude, "longitude": 16.37208}}
    add_meal(state, "P001", "2026-11-03")
    found = overview(client, admin)
    assert found["located_meals"] == 2
    assert [(each["local_date"], each["latitude"], each["longitude"]) for each in found["places"]] == [
        ("2026-11-02", -33.9, 16.372),
        ("2026-11-01", 48.208, 16.372),
    ]
    with state.database.write() as session:
        session.scalars(sa.select(Study)).one().location_policy = "drop"
    found = overview(client, admin)
    assert (found["located_meals"], found["places"]) == (None, [])


@pytest.mark.usefixtures("eaten")
def test_each_table_as_csv_has_the_rows_of_the_json(state, client, admin):
    with state.database.write() as session:
        person = session.scalars(sa.select(Participant).where(Participant.code == "P001")).one()
        person.code = "=P001"
        session.scalars(sa.select(Study)).one().location_policy = "keep"
        for meal in session.scalars(sa.select(Meal)):
            meal.details = {"location": {"latitude": 1.0, "longitude": 2.0}}
    whole = overview(client, admin)
    for part in ROWS:
        told = whole[part]
        answer = client.get(DAY_PATH, headers=admin, params={"format": "csv", "part": part})
        rows = list(csv.DictReader(io.StringIO(answer.text)))
        expected = told if isinstance(told, list) else [told]
        assert rows == [{name: as_cell(value) for name, value in row.items()} for row in expected] != [], part
        if part == "places":
            assert "'=P001" in {row["participant"] for row in rows}
    with state.database.read() as session:
        events = session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "overview.export")).all()
    assert sorted(event.details["part"] for event in events) == sorted(ROWS)


def as_cell(value):
    if value is None:
        return ""
    return f"'{value}" if isinstance(value, str) and value.startswith("=") else str(value)


def test_file_is_named_by_study_table_and_days(enrol, client, admin):
    enrol("P001")
    days = {"from": "2026-11-01", "to": "2026-11-03"}
    answer = client.get(DAY_PATH, headers=admin, params=days | {"format": "csv", "part": "days"})
    name = "pilot_overview-days_2026-11-01_2026-11-03.csv"
    assert answer.headers["content-disposition"] == f'attachment; filename="{name}"'
    answer = client.get("/v1/meals", headers=admin, params=days | {"study": "pilot", "format": "csv"})
    assert 'filename="pilot_meals_2026-11-01_2026-11-03.csv"' in answer.headers["content-disposition"]


def test_study_without_a_meal_has_an_overview_of_nothing_and_impossible_windows_are_refused(enrol, client, admin):
    enrol("P001")
    found = overview(client, admin)
    assert len(found["days"]) == 28
    assert found["completeness"] == {"expected": 0, "told": 0, "silent": 0, "closed": 0, "whole": 0, "meals": 0,
                                     "late_meals": 0, "median_delay_seconds": None}  # fmt: skip
    assert (found["histograms"], found["failures"], found["nutrients"][0]["mean"]) == ([], [], None)
    for params, code in (
        ({"from": "2026-11-02", "to": "2026-11-01"}, "days_reversed"),
        ({"from": "2024-11-02", "to": "2026-11-01"}, "days_too_many"),
        ({"format": "csv"}, "overview_part_missing"),
        ({"format": "csv", "part": "secrets"}, "invalid_input"),
    ):
        assert refusal(client.get(DAY_PATH, headers=admin, params=params)) == (422, code)


def test_window_at_the_end_of_the_calendar_is_empty(enrol, state, client, admin):
    enrol("P001", location_policy="keep")
    add_meal(state, "P001", "2026-11-01")
    for params in ({"from": "0001-01-01"}, {"to": "9999-12-31"}, {"from": "9999-12-31"}):
        assert overview(client, admin, **params)["completeness"]["meals"] == 0
