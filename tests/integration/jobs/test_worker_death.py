import signal

import pytest

from tests.integration.jobs.fakes import LONG_DRAIN, LONG_LEASE
from tests.support.waiting import PATIENCE_SECONDS, wait_until

pytestmark = pytest.mark.slow


def test_job_of_a_killed_worker_is_finished_by_another_and_saved_once_also_if_it_was_half_saved(jobs):
    job_id = jobs.add("hold")
    first = jobs.start_worker(lease=LONG_LEASE)  # so that it does not bury the second
    jobs.wait_for_file(f"computing-{job_id}-{first.pid}")
    second = jobs.start_worker()
    first.kill()
    first.wait()
    jobs.wait_for_file(f"computing-{job_id}-{second.pid}")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    assert jobs.saves(job_id) == [second.pid]
    assert jobs.job(job_id).attempts == 2
    wait_until(lambda: [worker.pid for worker in jobs.living()] == [second.pid], "the dead worker's lease to go")
    half_saved, waiting = jobs.add("hold_in_save"), jobs.add()
    jobs.wait_for_file(f"saving-{half_saved}-{second.pid}")
    second.kill()
    second.wait()
    jobs.go(half_saved)
    third = jobs.start_worker()
    for job_id in (half_saved, waiting):
        jobs.wait_for_state(job_id, "done")
        assert jobs.saves(job_id) == [third.pid]


def test_worker_asked_to_end_finishes_a_short_job_and_waits_for_what_its_chores_do_last(jobs):
    job_id = jobs.add("hold")
    worker = jobs.start_worker(drain=LONG_DRAIN)
    jobs.wait_for_file(f"computing-{job_id}-{worker.pid}")
    worker.terminate()
    jobs.go(job_id)
    assert worker.wait(timeout=PATIENCE_SECONDS) == 0
    assert jobs.job(job_id).state == "done"
    assert jobs.saves(job_id) == [worker.pid]
    assert (jobs.folder / f"left-{worker.pid}").exists()


@pytest.mark.both_stores
def test_stopped_worker_that_goes_on_after_takeover_writes_nothing(jobs):
    """PostgreSQL: the lease runs out. SQLite: the lock of a stopped process holds, so it is not taken over at all."""
    job_id = jobs.add("hold")
    first = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-{first.pid}")
    first.send_signal(signal.SIGSTOP)
    second = jobs.start_worker()
    if jobs.database.is_sqlite:
        other = jobs.add()
        jobs.wait_for_state(other, "done")
        jobs.go(job_id)
        first.send_signal(signal.SIGCONT)
        jobs.wait_for_state(job_id, "done")
        assert jobs.saves(job_id) == [first.pid]
        return
    jobs.wait_for_file(f"computing-{job_id}-{second.pid}")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    version = jobs.meal(job_id).version
    first.send_signal(signal.SIGCONT)
    assert first.wait(timeout=PATIENCE_SECONDS) == 75  # it notices, and ends to be started again under a new name
    assert jobs.saves(job_id) == [second.pid]
    assert jobs.meal(job_id).version == version


def test_nothing_is_locked_while_a_slow_store_is_waited_for(jobs):
    """That a lease which runs out meanwhile still guards: test_late_heartbeat.py."""
    job_id = jobs.add("hold_in_load")
    worker = jobs.start_worker()
    jobs.wait_for_file(f"loading-{job_id}-{worker.pid}")
    jobs.run_sql("UPDATE meal SET version = version + 1")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    assert jobs.saves(job_id) == [worker.pid]
    assert jobs.job(job_id).attempts == 1


@pytest.mark.parametrize("kind", ["postgres"])  # SQLite has one write lock: nothing but its going on can help
def test_worker_stopped_while_it_saves_keeps_nobody_waiting(jobs):
    job_id = jobs.add("hold_in_save")
    first = jobs.start_worker()
    jobs.wait_for_file(f"saving-{job_id}-{first.pid}")
    first.send_signal(signal.SIGSTOP)
    jobs.go(job_id)
    second = jobs.start_worker()
    jobs.wait_for_state(job_id, "done")
    first.send_signal(signal.SIGCONT)
    assert first.wait(timeout=PATIENCE_SECONDS) == 75
    assert jobs.saves(job_id) == [second.pid]


@pytest.mark.both_stores
def test_two_workers_share_jobs_and_do_none_twice(jobs):
    ids = [jobs.add() for _ in range(6)]
    workers = [jobs.start_worker(lease=LONG_LEASE) for _ in range(2)]
    ids += [jobs.add() for _ in range(6)]
    for job_id in ids:
        jobs.wait_for_state(job_id, "done")
    for job_id in ids:
        assert len(jobs.saves(job_id)) == 1
        assert jobs.job(job_id).attempts == 1
    assert {pid for job_id in ids for pid in jobs.saves(job_id)} <= {worker.pid for worker in workers}


@pytest.mark.both_stores
def test_job_that_was_claimed_and_never_begun_is_queued_again(jobs):
    """As after a restart of the database whose answer to the claim was lost."""
    job_id = jobs.add("hold")
    worker = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-{worker.pid}")
    executor = wait_until(jobs.living, "its heartbeat")[0].executor_id
    lost = jobs.add()
    jobs.change(lost, executor_id=executor)
    jobs.go(job_id)
    jobs.wait_for_state(lost, "done")
    assert jobs.saves(lost) == [worker.pid]
