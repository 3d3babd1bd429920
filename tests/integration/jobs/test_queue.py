import pytest

from app.jobs.queries import MAX_TAKEOVERS
from app.meals.stored.job_models import Job
from tests.integration.jobs.fakes import new_job
from tests.support.waiting import wait_until


def test_worker_saves_each_queued_job_once_takes_over_those_of_the_dead_and_gives_up_what_killed_too_many(jobs):
    class Stop(Exception):  # noqa: N818
        pass

    with pytest.raises(Stop), jobs.database.write() as session:  # noqa: PT012
        dropped = new_job(session, jobs.queue)
        raise Stop
    twice, last, of_the_dead, exhausted = jobs.add(), jobs.add(), jobs.add(), jobs.add("hold")
    with jobs.database.write() as session:
        jobs.queue.enqueue(session, session.get_one(Job, twice))
    jobs.change(of_the_dead, executor_id="a-dead-worker")
    jobs.change(exhausted, executor_id="a-dead-worker", takeovers=MAX_TAKEOVERS)
    worker = jobs.start_worker()
    for job_id in (last, of_the_dead):
        jobs.wait_for_state(job_id, "done")
    job = jobs.job(twice)
    assert jobs.saves(twice) == jobs.saves(of_the_dead) == [worker.pid]
    assert jobs.meal(twice).status == "estimated"
    assert (job.attempts, job.executor_id) == (1, wait_until(jobs.living, "its heartbeat")[0].executor_id)
    assert job.enqueued_at <= job.started_at <= job.finished_at
    assert (job.takeovers, jobs.job(of_the_dead).takeovers) == (0, 1)
    assert jobs.job(dropped) is None
    assert jobs.saves(dropped) == []
    wait_until(lambda: jobs.meal(exhausted).status == "failed", "the meal to be failed")
    assert jobs.meal(exhausted).failure_code == "job_gave_up"
    assert list(jobs.folder.glob(f"computing-{exhausted}-*")) == []
