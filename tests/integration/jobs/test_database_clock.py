"""The clock that leases go by is the database's, and it may be set back: by hand, by NTP, by a failover elsewhere."""

import pytest


@pytest.mark.parametrize("kind", ["postgres"])  # on SQLite a worker's life is a lock
def test_job_of_a_worker_that_died_before_the_clock_went_back_is_taken_over(jobs):
    job_id = jobs.add("hold")
    first = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-{first.pid}")
    first.kill()
    first.wait()
    jobs.run_sql("UPDATE worker_lease SET heartbeat_at = heartbeat_at + interval '1 hour'")  # what the clock said then
    assert jobs.living() == []
    second = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-{second.pid}")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    assert jobs.saves(job_id) == [second.pid]


@pytest.mark.parametrize("kind", ["postgres"])
def test_worker_that_lives_while_the_clock_goes_back_renews_its_lease(jobs):
    job_id = jobs.add("hold")
    worker = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-{worker.pid}")
    jobs.run_sql("UPDATE worker_lease SET heartbeat_at = heartbeat_at + interval '1 hour'")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    assert jobs.saves(job_id) == [worker.pid]
    assert worker.poll() is None
