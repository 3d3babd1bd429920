"""Workers beside others that are set otherwise, or are of another version; jobs that are not wanted any more."""

import time
from datetime import UTC, datetime
from itertools import pairwise

import pytest
import sqlalchemy as sa

from app.children.faults import CANCELLED
from app.jobs import queries as job_queries
from app.jobs.queue import JobQueue
from app.meals.job_models import Job
from tests.integration.jobs.fakes import LONG_LEASE, new_job
from tests.support.waiting import PATIENCE_SECONDS, wait_until

pytestmark = pytest.mark.slow


def computing(jobs):
    """Process id of the worker -> how many jobs it has begun."""
    begun = {}
    for path in jobs.folder.glob("computing-*"):
        pid = int(path.name.rsplit("-", 1)[1])
        begun[pid] = begun.get(pid, 0) + 1
    return begun


def test_each_worker_runs_as_many_jobs_as_it_is_set_to_beside_one_that_is_set_otherwise(jobs):
    ids = [jobs.add("hold") for _ in range(6)]
    small = jobs.start_worker(worker_concurrency=1, lease=LONG_LEASE)
    large = jobs.start_worker(worker_concurrency=3, lease=LONG_LEASE)
    wait_until(lambda: sum(computing(jobs).values()) == 4, "four jobs to be begun")
    time.sleep(0.6)  # more than two looks
    assert computing(jobs) == {small.pid: 1, large.pid: 3}
    for job_id in ids:
        jobs.go(job_id)
    for job_id in ids:
        jobs.wait_for_state(job_id, "done")


def test_next_jobs_begin_while_results_are_sealed_but_results_do_not_pile_up(jobs):
    ids = [jobs.add("seal_slowly") for _ in range(4)]
    worker = jobs.start_worker(worker_concurrency=1)

    def sealing():
        return [job_id for job_id in ids if (jobs.folder / f"sealing-{job_id}-{worker.pid}").exists()]

    wait_until(lambda: len(sealing()) == 2, "the second to be computed while the first is sealed")
    time.sleep(0.6)  # more than two looks
    assert computing(jobs) == {worker.pid: 2}
    first, second = sealing()
    jobs.go(first)
    wait_until(lambda: len(sealing()) == 3, "the third to be computed while the second is sealed")
    assert not jobs.saves(second)
    for job_id in ids:
        jobs.go(job_id)
    for job_id in ids:
        jobs.wait_for_state(job_id, "done")


def test_job_that_is_computed_again_since_the_store_was_away_takes_its_room_back(jobs):
    retried = jobs.add("store_away_once")
    worker = jobs.start_worker(worker_concurrency=1)
    wait_until((jobs.folder / f"again-{retried}").exists, "the first job to be in a child again")
    following = jobs.add("quick")
    time.sleep(0.6)  # more than two looks
    assert not (jobs.folder / f"computing-{following}-{worker.pid}").exists()
    jobs.go(retried)
    for job_id in (retried, following):
        jobs.wait_for_state(job_id, "done")


def test_worker_takes_the_first_job_of_another_study_before_the_backlog_of_the_one_it_is_at(jobs):
    large, small = jobs.new_study(), jobs.new_study()
    backlog = [jobs.add("hold", large) for _ in range(4)]
    worker = jobs.start_worker()
    jobs.wait_for_file(f"computing-{backlog[0]}-{worker.pid}")
    late = [jobs.add("hold", small) for _ in range(2)]
    order = [backlog[0], late[0], backlog[1], late[1], backlog[2], backlog[3]]
    for done, following in pairwise(order):
        jobs.go(done)
        jobs.wait_for_file(f"computing-{following}-{worker.pid}")
        assert sum(computing(jobs).values()) == 1 + order.index(following)


def test_worker_of_an_older_version_leaves_newer_jobs_to_a_newer_worker_which_runs_both(jobs):
    newer_queue = JobQueue(protocol=2)
    with jobs.database.write() as session:
        newer = new_job(session, newer_queue)
    old_worker = jobs.start_worker(protocol=1, lease=LONG_LEASE)
    older = [jobs.add() for _ in range(3)]
    for job_id in older:
        jobs.wait_for_state(job_id, "done")
    assert jobs.job(newer).state == "queued"
    assert jobs.job(newer).executor_id is None
    new_worker = jobs.start_worker(protocol=2, lease=LONG_LEASE)
    jobs.wait_for_state(newer, "done")
    assert jobs.saves(newer) == [new_worker.pid]
    old_worker.terminate()
    assert old_worker.wait(timeout=PATIENCE_SECONDS) == 0
    last = jobs.add()
    jobs.wait_for_state(last, "done")
    assert jobs.saves(last) == [new_worker.pid]


def test_job_of_a_dead_older_worker_is_taken_over_by_a_newer_one(jobs):
    job_id = jobs.add("hold")
    old_worker = jobs.start_worker(protocol=1)
    jobs.wait_for_file(f"computing-{job_id}-{old_worker.pid}")
    old_worker.kill()
    old_worker.wait()
    new_worker = jobs.start_worker(protocol=2)
    jobs.wait_for_file(f"computing-{job_id}-{new_worker.pid}")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    assert jobs.saves(job_id) == [new_worker.pid]


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
    for job_id in ids:
        assert (jobs.job(job_id).executor_id, jobs.job(job_id).takeovers) == (None, 0)
    second = jobs.start_worker(estimate_seconds=600, worker_concurrency=3)
    for job_id in ids:
        jobs.wait_for_file(f"computing-{job_id}-{second.pid}")
    with jobs.database.read() as session:
        assert set(session.scalars(sa.select(Job.attempts))) == {2}
