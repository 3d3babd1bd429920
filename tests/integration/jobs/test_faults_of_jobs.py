import pytest

from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow

CODES = {
    "child:segfault": "estimate_crashed",
    "child:spin": "estimate_timed_out",
    "child:killed": "estimate_killed",
    "child:eat_memory": "estimate_out_of_memory",
    "child:raise": "internal_error",
    "bug": "internal_error",
    "bug_in_save": "internal_error",
}


def test_fault_is_tried_again_until_it_passes_or_fails_the_meal_with_its_code_and_the_worker_goes_on(jobs):
    passing, killed_twice = jobs.add("full_disk"), jobs.add("child:killed_twice")
    bad = {fake: jobs.add(fake) for fake in CODES}
    good = jobs.add("child:describe")
    worker = jobs.start_worker(estimate_memory_bytes=512 * 1024 * 1024)
    wait_until(lambda: jobs.job(passing).attempts > 3, "more tries than a bug gets")
    jobs.go(passing)
    jobs.wait_for_state(good, "done")
    for fake, job_id in bad.items():
        jobs.wait_for_state(job_id, "failed")
        meal = jobs.meal(job_id)
        assert (meal.status, meal.failure_code) == ("failed", CODES[fake])
        assert meal.failure_message
        assert meal.failure_advice
        assert jobs.saves(job_id) == []
    assert jobs.job(bad["child:killed"]).attempts == 3
    assert "tried 3 times" in jobs.meal(bad["child:killed"]).failure_message
    for job_id in (passing, killed_twice):
        assert jobs.saves(job_id) == [worker.pid]
    assert jobs.job(killed_twice).attempts == 3  # one kill for want of memory failed a meal for good
    assert len(list(jobs.folder.glob(f"waits-{killed_twice}-*"))) == 2
    assert worker.poll() is None


@pytest.mark.both_stores
def test_job_with_a_passing_fault_holds_no_other_job_up(jobs):
    faulty = jobs.add("full_disk")
    good = [jobs.add() for _ in range(3)]
    worker = jobs.start_worker()  # which has one slot
    for job_id in good:
        jobs.wait_for_state(job_id, "done")
    assert jobs.job(faulty).faulty_since is not None
    jobs.go(faulty)
    jobs.wait_for_state(faulty, "done")
    assert jobs.saves(faulty) == [worker.pid]
    assert jobs.job(faulty).faulty_since is None


@pytest.mark.both_stores
def test_passing_fault_of_saving_is_tried_again_and_survives_a_takeover(jobs):
    job_id = jobs.add("full_disk_in_save")
    first = jobs.start_worker()
    jobs.wait_for_file(f"saving-{job_id}-{first.pid}")
    first.kill()
    first.wait()
    second = jobs.start_worker()
    jobs.wait_for_file(f"saving-{job_id}-{second.pid}")
    jobs.go(job_id)
    jobs.wait_for_state(job_id, "done")
    assert jobs.saves(job_id) == [second.pid]
    assert jobs.job(job_id).attempts == 1  # what the first had computed was used
    assert (jobs.job(job_id).takeovers, jobs.job(job_id).result_key) == (1, None)


@pytest.mark.parametrize("kind", ["postgres"])  # SQLite has none to lose
def test_job_survives_the_loss_of_every_connection(jobs):
    running, waiting = jobs.add("hold"), jobs.add()
    worker = jobs.start_worker()
    jobs.wait_for_file(f"computing-{running}-{worker.pid}")
    jobs.run_sql(
        "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity "
        "WHERE datname = current_database() AND pid <> pg_backend_pid()"
    )
    jobs.go(running)
    for job_id in (running, waiting):
        jobs.wait_for_state(job_id, "done")
        assert jobs.saves(job_id) == [worker.pid]
