"""Cancel and retry estimates, by the calls and by `tada jobs`."""

import json
import uuid
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.children.faults import INTERNAL_ERROR, JOB_GAVE_UP
from app.jobs import queries as jobs
from app.jobs.queue import JobQueue
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.record_models import Run
from app.meals.upload.look_after_jobs import FailedFilter, retry_failed
from app.people import privacy_queries as privacy
from app.people.privacy_models import AuditEvent
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.people.people import make_staff
from tests.integration.records.after_pairs import Table, left_of_apple
from tests.integration.records.at_once import at_once
from tests.support import estimates
from tests.support.deadlocks import deadlock_over_a_meal
from tests.support.estimates import found_item
from tests.support.photographs import pair

NO_MARKER = {"failure": {"code": "marker_not_found", "message": "No marker.", "advice": "Lay it flat."}}
HINT = {"hints": [{"point": [30, 20], "food": "apple"}]}


@pytest.fixture
def meal(phone):
    """A meal that waits; its id."""
    return phone.post(pair(1), meal_metadata(**HINT)).json()["id"]


@pytest.fixture
def reviewer(client, admin, phone):
    return make_staff(client, admin, "keller", pilot="reviewer")


def jobs_of(state, meal, purpose="meal"):
    with state.database.read() as session:
        query = sa.select(Job).join(Meal, Meal.id == Job.meal_id).where(Meal.client_id == uuid.UUID(meal))
        return list(session.scalars(query.where(Job.purpose == purpose).order_by(Job.enqueued_at)))


def fail(state, meal, failure=INTERNAL_ERROR):
    """As a worker fails a meal without a run."""
    with state.database.write() as session:
        job = session.get_one(Job, jobs_of(state, meal)[-1].id)
        jobs.fail_job(job, session.get_one(Meal, job.meal_id), failure, datetime.now(UTC))


def actions(state):
    with state.database.read() as session:
        return list(session.scalars(sa.select(AuditEvent.action).order_by(AuditEvent.at)))


def cancel(phone, meal):
    return phone.client.post(f"/v1/meals/{meal}/cancel", headers=phone.headers)


def test_phone_cancels_its_meal_which_fails_with_its_photographs_kept(phone, enrol, state, meal):
    """The worker's transaction asks for the job, as job_runner.py does: no later estimate is written."""
    assert cancel(enrol("P002"), meal).status_code == 404
    answer = cancel(phone, meal)
    assert answer.status_code == 200
    body = answer.json()
    assert (body["status"], body["failure"]["code"]) == ("failed", "cancelled")
    assert all(image["durable"] for image in body["images"].values())
    assert answer.headers["ETag"]
    (job,) = jobs_of(state, meal)
    assert (job.state, actions(state)[-1]) == ("failed", "meal.cancel")
    again = cancel(phone, meal)
    assert (again.status_code, again.headers["ETag"]) == (200, answer.headers["ETag"])
    with state.database.write() as session:
        assert jobs.lock_live_job(session, job.id) is None
        assert jobs.start_attempt(session, job.id, "w", datetime.now(UTC)) is None
    with state.database.read() as session:
        assert jobs.unwanted_jobs(session, [job.id]) == {job.id}


def test_measured_incomplete_or_failed_meal_has_nothing_to_cancel_and_the_answer_tells_why(phone, state, meal):
    announced, failed = meal_metadata(), phone.post(pair(2)).json()["id"]
    incomplete = announced.pop("id")
    phone.put(f"/v1/meals/{incomplete}", json=announced)
    estimates.save(state, meal, found_item())
    fail(state, failed, JOB_GAVE_UP)
    for meal_id, status in ((meal, "estimated"), (incomplete, "receiving"), (failed, "failed")):
        answer = cancel(phone, meal_id)
        assert (*refusal(answer), answer.json()["meal_status"]) == (409, "nothing_to_cancel", status)
        assert phone.get(f"/v1/meals/{meal_id}").json()["status"] == status
    assert answer.json()["failure_code"] == "job_gave_up"
    assert "has already failed (job_gave_up)" in answer.json()["detail"]


def test_meal_or_after_pair_whose_job_was_lost_is_cancelled_all_the_same(phone, state, meal):
    """A sweep would queue it again: whoever calls it off before that is obeyed."""
    table = Table(phone, state).measured().send_after()
    with state.database.write() as session:
        waiting = sa.update(Job).where(Job.state == "queued")
        session.execute(waiting.values(state="failed", finished_at=Job.enqueued_at))
    answer = cancel(phone, meal).json()
    assert (answer["status"], answer["failure"]["code"]) == ("failed", "cancelled")
    assert cancel(phone, table.id).status_code == 200
    assert (table.after["status"], table.after["failure"]["code"]) == ("failed", "cancelled")


def test_failed_meal_is_queued_again_with_a_new_job_and_its_new_run_counts(phone, state, reviewer, meal):
    estimates.save(state, meal, **NO_MARKER)
    assert phone.get(f"/v1/meals/{meal}").json()["status"] == "failed"
    answer = reviewer.post(f"/v1/meals/{meal}/retry")
    assert (answer.status_code, answer.headers["Location"]) == (202, f"/v1/meals/{meal}")
    assert (answer.json()["status"], answer.json()["failure"]) == ("queued", None)
    first, second = jobs_of(state, meal)
    assert (first.state, second.state) == ("done", "queued")
    assert second.turn > first.turn
    assert actions(state)[-1] == "meal.retry"
    estimates.save(state, meal, found_item())
    body = phone.get(f"/v1/meals/{meal}").json()
    assert (body["status"], len(body["items"])) == ("estimated", 1)
    with state.database.read() as session:
        assert set(session.scalars(sa.select(Run.id))) == {first.id, second.id}


def say(phone, meal, kind, **fields):
    event = {"id": str(uuid.uuid4()), "kind": kind} | fields
    return phone.client.post(f"/v1/meals/{meal}/events", headers=phone.headers | {"If-Match": "*"}, json=event)


def test_comment_on_a_meal_that_is_retried_does_not_move_its_status_back(phone, state, reviewer, meal):
    """Its last run has failed, and says nothing of the one to come."""
    estimates.save(state, meal, **NO_MARKER)
    reviewer.post(f"/v1/meals/{meal}/retry")
    answer = say(phone, meal, "comment", text="cold")
    assert (answer.status_code, answer.json()["status"]) == (201, "queued")
    estimates.save(state, meal, **NO_MARKER)
    body = phone.get(f"/v1/meals/{meal}").json()
    assert (body["status"], body["failure"]["code"]) == ("failed", "marker_not_found")


def test_retries_at_once_queue_one_job(state, reviewer, meal):
    fail(state, meal)
    answers = at_once(*[lambda: reviewer.post(f"/v1/meals/{meal}/retry").status_code] * 4)
    assert sorted(answers) == [200, 200, 200, 202]
    assert [job.state for job in jobs_of(state, meal)] == ["failed", "queued"]


def test_confirmed_and_measured_meals_are_not_moved_by_a_retry(phone, state, reviewer, meal):
    estimates.save(state, meal, found_item())
    for status in ("estimated", "confirmed"):
        answer = reviewer.post(f"/v1/meals/{meal}/retry")
        assert (*refusal(answer), answer.json()["meal_status"]) == (409, "nothing_to_retry", status)
        say(phone, meal, "confirm_meal")
    assert len(jobs_of(state, meal)) == 1


def test_failed_after_pair_of_a_confirmed_meal_is_measured_again_and_only_that(phone, state, reviewer):
    table = Table(phone, state).measured().send_after()
    table.after_measured(**NO_MARKER)
    say(phone, table.id, "confirm_meal")
    body = reviewer.post(f"/v1/meals/{table.id}/retry").json()
    assert (body["status"], body["after"]["status"], body["after"]["failure"]) == ("confirmed", "queued", None)
    assert not any("after_failed" in item["flags"] for item in body["items"])
    table.after_measured(left_of_apple())
    body = table.get()
    assert (body["status"], body["after"]["status"]) == ("confirmed", "estimated")
    assert len(jobs_of(state, table.id)) == 1


def test_retried_meal_waits_from_now_on_and_one_without_photographs_is_not_retried(client, state, reviewer, meal):
    """/readyz tells how long the oldest waits: not since it was sent, days ago."""
    with state.database.write() as session:
        session.execute(sa.update(Meal).values(submitted_at=datetime.now(UTC) - timedelta(days=3)))
    fail(state, meal)
    reviewer.post(f"/v1/meals/{meal}/retry")
    assert client.get("/readyz").json()["oldest_waiting_seconds"] < 3600
    fail(state, meal)
    with state.database.write() as session:
        session.execute(sa.update(MealImage).values(erased_at=datetime.now(UTC)))
    assert refusal(reviewer.post(f"/v1/meals/{meal}/retry")) == (410, "photograph_erased")
    assert len(jobs_of(state, meal)) == 2


def test_jobs_list_tells_what_waits_and_what_failed(phone, enrol, state, meal, tada):
    failed = phone.post(pair(2), meal_metadata()).json()["id"]
    fail(state, failed)
    other = enrol("P009", study="other").post(pair(3), meal_metadata()).json()["id"]
    waiting = json.loads(tada("jobs", "list", "--json").stdout)
    assert {(row["meal"], row["study"], row["state"]) for row in waiting} == {
        (meal, "pilot", "queued"),
        (other, "other", "queued"),
    }
    assert [row["meal"] for row in json.loads(tada("jobs", "list", "--study", "other", "--json").stdout)] == [other]
    (row,) = json.loads(tada("jobs", "list", "--failed", "--json").stdout)
    assert (row["meal"], row["participant"], row["purpose"], row["code"]) == (failed, "P001", "meal", "internal_error")
    assert "internal_error" in tada("jobs", "list", "--failed").stdout
    assert json.loads(tada("jobs", "list", "--failed", "--code", "job_gave_up", "--json").stdout) == []
    assert tada("jobs", "list", "--study", "none").returncode == 2
    assert tada("jobs", "list", "--code", "x").returncode == 2
    assert "--limit" in tada("jobs", "list", "--limit", "1").stderr


def test_retry_that_the_database_ends_for_anothers_sake_is_done_again(phone, state, meal):
    """The other has locked the meal and wants its person; on SQLite the retry just waits for its turn."""
    fail(state, meal)
    job = jobs_of(state, meal)[-1]
    with deadlock_over_a_meal(state.database, job.meal_id, privacy.lock_participant):
        assert retry_failed(state.database, state.part(JobQueue), FailedFilter(code=INTERNAL_ERROR.code)).queued == 1
    assert [one.state for one in jobs_of(state, meal)] == ["failed", "queued"]


def test_jobs_retry_by_code_takes_those_and_leaves_what_cannot_be(phone, state, tada):
    meals = [phone.post(pair(seed), meal_metadata()).json()["id"] for seed in (1, 2, 3)]
    estimates.save(state, meals[0], **NO_MARKER)
    fail(state, meals[1])
    fail(state, meals[2])
    with state.database.write() as session:
        mine = sa.select(Meal.id).where(Meal.client_id == uuid.UUID(meals[2]))
        session.execute(sa.update(MealImage).where(MealImage.meal_id.in_(mine)).values(erased_at=datetime.now(UTC)))
    tomorrow = (datetime.now(UTC) + timedelta(days=1)).isoformat()
    assert "0 meals" in tada("jobs", "retry", "--code", "internal_error", "--since", tomorrow).stdout
    ended = tada("jobs", "retry", "--code", "internal_error", "--study", "pilot", "--since", "2020-01-01")
    assert ended.stdout.splitlines() == ["1 meals queued again", "1 not queued: photograph_erased"]
    assert [len(jobs_of(state, one)) for one in meals] == [1, 2, 1]
    assert "0 meals" in tada("jobs", "retry", "--code", "internal_error").stdout


def test_jobs_retry_by_code_leaves_alone_what_of_the_meal_was_called_off(phone, state, tada):
    table = Table(phone, state).measured().send_after()
    phone.client.post(f"/v1/meals/{table.id}/cancel", headers=phone.headers)
    with state.database.write() as session:
        failed = {"status": "failed", "failure_code": INTERNAL_ERROR.code}
        session.execute(sa.update(Meal).where(Meal.client_id == uuid.UUID(table.id)).values(failed))
    assert "1 meals" in tada("jobs", "retry", "--code", INTERNAL_ERROR.code).stdout
    assert [job.state for job in jobs_of(state, table.id)][-1] == "queued"
    assert [job.state for job in jobs_of(state, table.id, "after")] == ["failed"]
    assert table.get()["after"]["failure"]["code"] == "cancelled"


def test_jobs_retry_and_cancel_by_id_tell_of_each_and_fail_for_those_that_could_not(state, meal, tada):
    unknown = str(uuid.uuid4())
    ended = tada("jobs", "cancel", meal, unknown)
    assert (ended.returncode, ended.stdout) == (1, f"{meal}: cancelled\n")
    assert unknown in ended.stderr
    assert tada("jobs", "cancel", meal).stdout == f"{meal}: was cancelled before\n"
    assert tada("jobs", "retry", meal).stdout == f"{meal}: queued again\n"
    again = tada("jobs", "retry", meal)
    assert (again.returncode, again.stdout) == (0, f"{meal}: waits already\n")
    assert [job.state for job in jobs_of(state, meal)] == ["failed", "queued"]
    assert tada("jobs", "retry").returncode == 2
    assert tada("jobs", "retry", meal, "--code", "cancelled").returncode == 2
    assert tada("jobs", "retry", "--code", "cancelled", "--since", "yesterday").returncode == 2
