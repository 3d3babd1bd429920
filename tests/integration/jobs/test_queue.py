import pytest

from app.meals.job_models import Job
from tests.integration.jobs.fakes import new_job
from tests.support.waiting import wait_until


def test_queued_job_is_saved_once_though_it_was_queued_twice_and_that_of_a_rolled_back_transaction_never(jobs):
    class Stop(Exception):  # noqa: N818
        pass

    with pytest.raises(Stop), jobs.database.write() as session:  # noqa: PT012
        dropped = new_job(session, jobs.queue)
        raise Stop
    twice, last = jobs.add(), jobs.add()
    with jobs.database.write() as session:
        jobs.queue.enqueue(session, session.get_one(Job, twice))
    worker = jobs.start_worker()
    jobs.wait_for_state(last, "done")
    job = jobs.job(twice)
    assert jobs.saves(twice) == [worker.pid]
    assert jobs.meal(twice).status == "estimated"
    assert (job.attempts, job.executor_id) == (1, wait_until(jobs.living, "its heartbeat")[0].executor_id)
    assert job.enqueued_at <= job.started_at <= job.finished_at
    assert jobs.job(dropped) is None
    assert jobs.saves(dropped) == []
