import pytest

from app.db.models import Job, Meal
from app.jobs.sweep import sweep
from tests.integration.jobs.conftest import wait_until
from tests.integration.jobs.fakes import new_job_without_workflow, new_meal


def settle(session, meal):
    meal.details = meal.details | {"settled": True}


def test_job_without_workflow_is_queued_again(jobs):
    with jobs.database.write() as session:
        job, _ = new_job_without_workflow(session)
    assert sweep(jobs.database, jobs.queue, settle) == 1
    assert jobs.workflow_status(job.id) == "ENQUEUED"
    assert sweep(jobs.database, jobs.queue, settle) == 0


def test_waiting_meal_without_job_gets_one(jobs):
    with jobs.database.write() as session:
        meal = new_meal(session)
    assert sweep(jobs.database, jobs.queue, settle) == 1
    assert sweep(jobs.database, jobs.queue, settle) == 0
    with jobs.database.read() as session:
        job = session.query(Job).filter_by(meal_id=meal.id).one()
    assert jobs.workflow_status(job.id) == "ENQUEUED"


def test_waiting_meal_whose_job_ended_is_failed(jobs):
    with jobs.database.write() as session:
        job, _ = new_job_without_workflow(session)
        job.state = "done"
    assert sweep(jobs.database, jobs.queue, settle) == 1
    assert jobs.meal(job.id).failure_code == "internal_error"
    assert sweep(jobs.database, jobs.queue, settle) == 0


def test_job_whose_workflow_ended_without_it_is_failed_visibly(jobs):
    codes = {
        "MAX_RECOVERY_ATTEMPTS_EXCEEDED": "job_gave_up",
        "CANCELLED": "cancelled",
        "ERROR": "internal_error",
        "SUCCESS": "internal_error",
    }
    ended = {status: jobs.add() for status in codes}
    for status, job_id in ended.items():
        jobs.run_sql(f"UPDATE {jobs.workflow_table} SET status = '{status}' WHERE workflow_uuid = '{job_id}'")
    before = jobs.meal(ended["ERROR"]).version
    assert sweep(jobs.database, jobs.queue, settle) == len(codes)
    for status, job_id in ended.items():
        meal = jobs.meal(job_id)
        assert (jobs.job(job_id).state, meal.status, meal.failure_code) == ("failed", "failed", codes[status])
        assert meal.version == before + 1
    assert sweep(jobs.database, jobs.queue, settle) == 0


@pytest.mark.parametrize("purpose", ["after", "remeasure"])
def test_dead_job_of_another_purpose_leaves_the_meals_own_answer(jobs, purpose):
    with jobs.database.write() as session:
        job, meal = new_job_without_workflow(session)
        jobs.queue.enqueue(session, job)
        job.purpose, meal.status, meal.after_status = purpose, "estimated", "queued"
    jobs.run_sql(f"UPDATE {jobs.workflow_table} SET status = 'ERROR' WHERE workflow_uuid = '{job.id}'")
    sweep(jobs.database, jobs.queue, settle)
    meal = jobs.meal(job.id)
    assert (jobs.job(job.id).state, meal.status, meal.failure_code) == ("failed", "estimated", None)
    assert meal.details["settled"]
    failed = ("failed", "internal_error") if purpose == "after" else ("queued", None)
    assert (meal.after_status, meal.after_failure_code) == failed


def test_waiting_after_pair_without_job_gets_one_and_is_failed_once_that_has_ended(jobs):
    with jobs.database.write() as session:
        meal = new_meal(session)
        meal.status, meal.after_status = "estimated", "processing"
    assert sweep(jobs.database, jobs.queue, settle) == 1
    with jobs.database.write() as session:
        job = session.query(Job).filter_by(meal_id=meal.id).one()
        assert (job.purpose, session.get(Meal, meal.id).after_status) == ("after", "queued")
        job.state = "done"
    assert sweep(jobs.database, jobs.queue, settle) == 1
    meal = jobs.meal(job.id)
    assert (meal.status, meal.after_status, meal.details["settled"]) == ("estimated", "failed", True)
    assert sweep(jobs.database, jobs.queue, settle) == 0


def test_job_that_something_will_move_is_left_alone(jobs):
    for status in ("PENDING", "ENQUEUED", "DELAYED"):
        job_id = jobs.add()
        jobs.run_sql(f"UPDATE {jobs.workflow_table} SET status = '{status}' WHERE workflow_uuid = '{job_id}'")
    assert sweep(jobs.database, jobs.queue, settle) == 0
    assert jobs.job(job_id).state == "queued"


def test_job_taken_over_too_often_is_given_up_visibly(jobs):
    job_id = jobs.add("hold")
    jobs.run_sql(f"UPDATE {jobs.workflow_table} SET recovery_attempts = 99 WHERE workflow_uuid = '{job_id}'")
    jobs.start_worker()
    wait_until(lambda: jobs.meal(job_id).status == "failed", "the meal to be failed")
    assert jobs.meal(job_id).failure_code == "job_gave_up"
