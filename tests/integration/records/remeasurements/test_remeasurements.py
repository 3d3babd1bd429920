"""Remeasurements over HTTP and at the command line: chosen, skipped, stopped, continued, listed; releases stay."""

import csv
import io
import json
import uuid
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.jobs.queue import JobQueue
from app.meals.stored.job_models import Job, RemeasuredItem, RemeasuredPair, Remeasurement
from app.meals.stored.models import Meal, MealImage
from app.people.models import Participant
from app.people.privacy_models import AuditEvent
from app.records.remeasurements.remeasurements import FeedWorkers
from tests.integration.conftest import meal_metadata
from tests.integration.records.at_once import at_once
from tests.integration.records.eating import eaten
from tests.integration.records.remeasurements.measuring_again import PATH, Again
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair


@pytest.fixture
def again(client, admin, state, phone):
    return Again(client, admin, state)


@pytest.fixture
def meals(phone, state):
    """Three measured meals, in the order in which they were eaten."""
    return [measured(phone, state, hour) for hour in (8, 12, 18)]


def measured(phone, state, hour):
    return eaten(phone, state, seed=hour, captured_at=f"2026-11-20T{hour:02}:30:00+08:00")


def answers_of(meals, volume_ml=185.0):
    return {(meal, "rerun"): [found_item(volume_ml)] for meal in meals}


def change(state, table, condition, **values):
    with state.database.write() as session:
        assert session.execute(sa.update(table).where(condition).values(values)).rowcount > 0


def client_id(meal):
    return Meal.client_id == uuid.UUID(meal)


def test_progress_is_counted_and_the_table_is_a_file_too(again, meals):
    started = again.start()
    assert (started["state"], started["pairs"], started["waiting"], started["ended_at"]) == ("running", 3, 3, None)
    assert again.feed(1) == 1
    estimates.save(again.state, meals[0], found_item(190.0), purpose="rerun")
    assert [again.get(started["id"]).json()[name] for name in ("waiting", "measured", "items")] == [2, 1, 1]
    again.measure(answers_of(meals[1:]))
    ended = again.get(started["id"]).json()
    assert (ended["state"], ended["measured"], ended["items_changed"]) == ("done", 3, 1)
    rows, cursor = [], None
    while True:
        page = again.get(started["id"], "/items", limit=1, **({"cursor": cursor} if cursor else {})).json()
        rows += page["items"]
        if page["next"] is None:
            break
        cursor = page["next"].partition("cursor=")[2].partition("&")[0]
    assert [row["meal_id"] for row in rows] == meals
    table = again.get(started["id"], "/items", format="csv").text
    from_file = list(csv.DictReader(io.StringIO(table)))
    assert [(row["meal_id"], float(row["new_volume_ml"])) for row in from_file] == [
        (meals[0], 190.0),
        (meals[1], 185.0),
        (meals[2], 185.0),
    ]
    listed = again.client.get(PATH, headers=again.headers).json()["items"]
    assert listed == [ended]


def test_meals_with_nothing_to_measure_are_skipped_with_the_reason(again, meals, phone, state, enrol):
    change(state, MealImage, MealImage.meal_id.in_(sa.select(Meal.id).where(client_id(meals[0]))), erased_at=now())
    phone.client.post("/v1/declared-meals", headers=phone.headers, json=meal_metadata(items=[{"food": "apple"}]))
    waits = meal_metadata(captured_at="2026-11-20T19:00:00+08:00")
    phone.post(pair(1), waits)
    incomplete = meal_metadata(captured_at="2026-11-20T20:00:00+08:00")
    phone.put(f"/v1/meals/{incomplete.pop('id')}", json=incomplete)
    called_off = meal_metadata(captured_at="2026-11-20T21:00:00+08:00")
    phone.post(pair(2), called_off)
    phone.client.post(f"/v1/meals/{called_off['id']}/cancel", headers=phone.headers)
    measured(enrol("P002"), state, 22)
    change(state, Participant, Participant.code == "P002", withdrawn_at=now())
    numbers, rows = again.done(answers_of(meals[1:]))
    assert (numbers["measured"], numbers["skipped"]) == (2, 6)
    assert numbers["reasons"] == {
        "cancelled": 1,
        "incomplete": 1,
        "no_photographs": 1,
        "photograph_erased": 1,
        "waits_for_estimate": 1,
        "withdrawn": 1,
    }
    assert {row["state"] for row in rows} == {"measured", "skipped"}


def now():
    return datetime.now(UTC)


def test_named_meals_and_a_limit_choose_the_first_that_were_eaten(again, meals):
    _, rows = again.done(answers_of(meals[:2]), meals=meals[:2][::-1])
    assert [row["meal_id"] for row in rows] == meals[:2]
    _, rows = again.done(answers_of(meals[:1]), limit=1)
    assert [row["meal_id"] for row in rows] == meals[:1]
    other = str(uuid.uuid4())
    assert again.start(404, meals=[meals[0], other])["meal"] == other
    assert again.get(other).status_code == 404


def test_stopped_it_gives_its_pair_back_and_continued_it_loses_and_doubles_nothing(again, meals, state):
    started = again.start()
    assert again.feed(1) == 1
    estimates.save(state, meals[0], found_item(190.0), purpose="rerun")
    assert again.feed(2) == 2
    ready = again.client.get("/readyz").json()  # background jobs are no meals that wait
    assert ready["oldest_waiting_seconds"] is None
    stopped = again.deed(started["id"], "stop")
    assert (stopped["state"], stopped["waiting"], stopped["measured"]) == ("stopped", 2, 1)
    assert again.live() == []
    with state.database.read() as session:
        assert None not in session.scalars(sa.select(Job.finished_at).where(Job.is_background)).all()
    with pytest.raises(sa.exc.NoResultFound):  # a worker that comes back saves nothing
        estimates.save(state, meals[1], found_item(190.0), purpose="rerun")
    assert again.feed(3) == 0
    assert again.deed(started["id"], "stop") == stopped
    assert again.deed(started["id"], "continue")["state"] == "running"
    assert again.deed(started["id"], "continue")["state"] == "running"
    again.measure(answers_of(meals[1:], 200.0))
    ended = again.get(started["id"]).json()
    assert (ended["state"], ended["measured"], ended["items"]) == ("done", 3, 3)
    for deed in ("stop", "continue"):
        assert again.deed(started["id"], deed, 409)["code"] == "remeasurement_done"
    with state.database.read() as session:
        ids = session.scalars(sa.select(RemeasuredPair.job_id)).all()
        assert len(set(ids)) == 3
        actions = session.scalars(sa.select(AuditEvent.action).order_by(AuditEvent.id)).all()
    assert [action for action in actions if action.startswith("remeasurement.")] == [
        "remeasurement.start",
        "remeasurement.stop",
        "remeasurement.continue",
    ]


def test_same_request_again_is_the_same_remeasurement_and_another_has_to_wait(again, meals):
    started = again.start()
    assert again.start(200)["id"] == started["id"]
    refused = again.start(409, limit=1)
    assert (refused["code"], refused["remeasurement"]) == ("remeasurement_running", started["id"])
    again.deed(started["id"], "stop")
    other = again.start(limit=1)
    assert other["id"] != started["id"]
    assert again.deed(started["id"], "continue", 409)["code"] == "remeasurement_running"
    again.measure(answers_of(meals[:1]))
    resumed = again.start(200)
    assert (resumed["id"], resumed["state"]) == (started["id"], "running")
    again.measure(answers_of(meals))
    assert again.start()["id"] != started["id"]  # it is done: a new one


@pytest.mark.both_stores
def test_workers_that_feed_at_the_same_time_queue_each_pair_once(again, phone, state):
    meals = [measured(phone, state, hour) for hour in range(6, 14)]
    again.start()
    feeds = [FeedWorkers(state.database, JobQueue()) for _ in range(4)]
    at_once(*(lambda feed=feed: [feed(1) for _ in range(3)] for feed in feeds))
    while again.feed(1):
        pass
    live = again.live()
    assert sorted(live) == sorted((meal, "rerun") for meal in meals)


def test_erased_meal_takes_its_part_of_the_remeasurement_with_it(again, meals, phone, state):
    started = again.start()
    assert again.feed(1) == 1
    estimates.save(state, meals[0], found_item(190.0), purpose="rerun")
    assert again.feed(1) == 1  # the second is being measured
    for meal in meals[:2]:
        assert phone.client.delete(f"/v1/meals/{meal}", headers=phone.headers).status_code == 200
    again.measure(answers_of(meals[2:]))
    ended = again.get(started["id"]).json()
    assert (ended["state"], ended["pairs"], ended["measured"]) == ("done", 1, 1)
    with state.database.read() as session:
        assert len(session.scalars(sa.select(RemeasuredItem)).all()) == 1


def test_command_lists_a_plan_and_changes_nothing_and_refuses_what_is_not_there(again, meals, tada):
    nowhere = tada("remeasure", "nowhere")
    assert (nowhere.returncode, nowhere.stderr) == (2, "tada: There is no such study.\n")
    missing = str(uuid.uuid4())
    assert tada("remeasure", missing).stderr == f"tada: There is no meal {missing}.\n"
    ended = tada("remeasure", "pilot", "--dry-run", "--limit", "2")
    assert ended.returncode == 0, ended.stderr
    lines = ended.stdout.splitlines()
    assert lines[0].split() == ["pilot/P001", meals[0], "meal", "would", "be", "measured"]
    assert lines[-1] == "pilot: 2 of 2 pairs would be measured"
    (document,) = json.loads(tada("remeasure", meals[2], "--dry-run", "--json").stdout)
    assert [(row["meal"], row["skip"]) for row in document["rows"]] == [(meals[2], None)]
    assert again.client.get(PATH, headers=again.headers).json()["items"] == []


def test_command_starts_and_follows_until_it_is_done(again, meals, tada, monkeypatch):
    assert "0 of 3 pairs" in tada("remeasure", "pilot", "--no-wait").stdout
    again.measure(answers_of(meals[:2], 200.0) | answers_of(meals[2:]))
    ended = tada("remeasure", "pilot", "--no-wait", "--json")  # the first one is done: another
    (document,) = json.loads(ended.stdout)
    assert (document["pairs"], document["waiting"]) == (3, 3)
    with monkeypatch.context() as patch:

        def measure(_):
            """A worker, while the command waits for the first time; all is done when it looks again."""
            patch.undo()
            again.measure(answers_of(meals))

        patch.setattr("app.cli.remeasure.time.sleep", measure)
        ended = tada("remeasure", "pilot")
    assert ended.returncode == 0, ended.stderr
    assert "continued, " in ended.stderr
    assert "3 of 3 pairs (3 measured, 0 kept, 0 skipped)" in ended.stdout
    assert ended.stdout.splitlines()[-1].endswith("2 of 3 items differ")
    assert f"{meals[0]}  meal   apple" in ended.stdout
    assert "200.0 [180.0, 220.0] -> 185.0 [166.5, 203.5] ml" in ended.stdout


def test_interrupted_command_stops_it_and_the_same_command_goes_on(again, meals, tada, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("app.cli.remeasure.time.sleep", interrupt)
        ended = tada("remeasure", *meals[:2])
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (1, "Stopped. The same command continues it.")
    assert "no worker is running" in ended.stderr
    with again.state.database.read() as session:
        assert session.scalars(sa.select(Remeasurement.state)).all() == ["stopped"]
    assert "continued, 2 of 2 pairs left" in tada("remeasure", *meals[:2], "--no-wait").stderr
    again.measure(answers_of(meals[:2]))
    with again.state.database.read() as session:
        assert session.scalars(sa.select(Remeasurement.state)).all() == ["done"]
