import pytest

from app.jobs.queries import MAX_TAKEOVERS
from app.jobs.queue import sweep
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from tests.integration.jobs.fakes import new_meal, new_unqueued_job


def settle(session, meal):
    meal.details = meal.details | {"settled": True}


def test_waiting_meal_without_job_gets_one_and_is_failed_once_that_has_ended(jobs):
    with jobs.database.write() as session:
        meal = new_meal(session)
    assert sweep(jobs.database, jobs.queue, settle) == 1
    assert sweep(jobs.database, jobs.queue, settle) == 0
    with jobs.database.write() as session:
        job = session.query(Job).filter_by(meal_id=meal.id).one()
        assert (job.state, job.turn, job.executor_id) == ("queued", 1, None)
        job.state, job.finished_at = "done", job.enqueued_at
    assert sweep(jobs.database, jobs.queue, settle) == 1
    assert jobs.meal(job.id).failure_code == "internal_error"
    assert sweep(jobs.database, jobs.queue, settle) == 0


def test_job_taken_over_too_often_is_given_up_visibly(jobs):
    job_id = jobs.add()
    jobs.change(job_id, takeovers=MAX_TAKEOVERS + 1)
    before = jobs.meal(job_id).version
    assert sweep(jobs.database, jobs.queue, settle) == 1
    meal = jobs.meal(job_id)
    assert (jobs.job(job_id).state, meal.status, meal.failure_code) == ("failed", "failed", "job_gave_up")
    assert meal.version == before + 1
    assert sweep(jobs.database, jobs.queue, settle) == 0


@pytest.mark.parametrize("purpose", ["after", "remeasure"])
def test_dead_job_of_another_purpose_leaves_the_meals_own_answer(jobs, purpose):
    with jobs.database.write() as session:
        job, meal = new_unqueued_job(session)
        jobs.queue.enqueue(session, job)
        job.purpose, meal.status, meal.after_status = purpose, "estimated", "queued"
    jobs.change(job.id, takeovers=MAX_TAKEOVERS + 1)
    sweep(jobs.database, jobs.queue, settle)
    meal = jobs.meal(job.id)
    assert (jobs.job(job.id).state, meal.status, meal.failure_code) == ("failed", "estimated", None)
    assert meal.details["settled"]
    failed = ("failed", "job_gave_up") if purpose == "after" else ("queued", None)
    assert (meal.after_status, meal.after_failure_code) == failed


def test_waiting_after_pair_without_job_gets_one_and_is_failed_once_that_has_ended(jobs):
    with jobs.database.write() as session:
        meal = new_meal(session)
        meal.status, meal.after_status = "estimated", "processing"
    assert sweep(jobs.database, jobs.queue, settle) == 1
    with jobs.database.write() as session:
        job = session.query(Job).filter_by(meal_id=meal.id).one()
        assert (job.purpose, session.get(Meal, meal.id).after_status) == ("after", "queued")
        job.state, job.finished_at = "done", job.enqueued_at
    assert sweep(jobs.database, jobs.queue, settle) == 1
    meal = jobs.meal(job.id)
    assert (meal.status, meal.after_status, meal.details["settled"]) == ("estimated", "failed", True)
    assert sweep(jobs.database, jobs.queue, settle) == 0


def test_job_that_a_worker_has_or_will_have_is_left_alone(jobs):
    for values in ({}, {"executor_id": "somebody"}, {"executor_id": "somebody", "state": "processing"}):
        job_id = jobs.add()
        jobs.change(job_id, takeovers=MAX_TAKEOVERS, **values)
    assert sweep(jobs.database, jobs.queue, settle) == 0
    assert jobs.job(job_id).state == "processing"
