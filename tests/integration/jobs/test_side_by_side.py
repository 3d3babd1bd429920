"""Workers beside others that are set otherwise, or are of another version; jobs that are not wanted any more."""

from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.children.faults import CANCELLED
from app.jobs import queries as job_queries
from app.jobs.queue import JobQueue
from app.meals.stored.job_models import Job
from tests.integration.jobs.fakes import LONG_LEASE, new_job
from tests.support.waiting import PATIENCE_SECONDS

pytestmark = pytest.mark.slow


def test_worker_of_an_older_version_leaves_newer_jobs_to_a_newer_worker_which_runs_both_and_takes_over(jobs):
    newer_queue = JobQueue(protocol=2)
    with jobs.database.write() as session:
        newer = new_job(session, newer_queue)
    old_worker = jobs.start_worker(protocol=1, lease=LONG_LEASE)
    older, held = jobs.add(), jobs.add("hold")
    jobs.wait_for_file(f"computing-{held}-{old_worker.pid}")
    assert jobs.saves(older) == [old_worker.pid]
    assert (jobs.job(newer).state, jobs.job(newer).executor_id) == ("queued", None)
    new_worker = jobs.start_worker(protocol=2)
    jobs.wait_for_state(newer, "done")
    assert jobs.saves(newer) == [new_worker.pid]
    old_worker.kill()
    old_worker.wait()
    jobs.wait_for_file(f"computing-{held}-{new_worker.pid}")
    jobs.go(held)
    jobs.wait_for_state(held, "done")
    assert jobs.saves(held) == [new_worker.pid]


def test_child_of_a_cancelled_job_is_ended_and_the_worker_goes_on(jobs):
    job_id = jobs.add("child:hang")
    worker = jobs.start_worker(estimate_seconds=600)
    jobs.wait_for_file(f"computing-{job_id}-{worker.pid}")
    with jobs.database.write() as session:
        job, meal = job_queries.lock_live_job(session, job_id)
        job_queries.fail_job(job, meal, CANCELLED, datetime.now(UTC))
    jobs.wait_for_file(f"abandoned-{job_id}")
    following = jobs.add()
    jobs.wait_for_state(following, "done")
    assert worker.poll() is None
    assert jobs.meal(job_id).failure_code == "cancelled"
    assert jobs.saves(job_id) == []
    assert left_behind(jobs) == []


def left_behind(jobs):
    with jobs.database.read() as session:
        return job_queries.exhausted_jobs(session) + job_queries.waiting_without_live_job(session)


@pytest.mark.both_stores
def test_workers_asked_to_end_hand_several_jobs_back_and_others_begin_them_at_once(jobs):
    """Children that ignore what they are asked, as these do; nothing is counted as a death."""
    ids = [jobs.add("child:hang") for _ in range(3)]
    first = jobs.start_worker(estimate_seconds=600, worker_concurrency=3)
    for job_id in ids:
        jobs.wait_for_file(f"computing-{job_id}-{first.pid}")
    first.terminate()
    assert first.wait(timeout=PATIENCE_SECONDS) == 0
    assert jobs.living() == []
    for job_id in ids:
        job = jobs.job(job_id)
        assert (job.executor_id, job.takeovers, job.state) == (None, 0, "processing")
        assert jobs.meal(job_id).status == "processing"
    second = jobs.start_worker(estimate_seconds=600, worker_concurrency=3)
    for job_id in ids:
        jobs.wait_for_file(f"computing-{job_id}-{second.pid}")
    with jobs.database.read() as session:
        assert set(session.scalars(sa.select(Job.attempts))) == {2}
