"""Fair between studies: in which order workers take what waits, as their own claims do."""

from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from app.jobs.queries import LONGEST_PUT_OFF, WorkerTimes, claim_jobs, put_off, release_claims
from app.jobs.queue import JobQueue
from app.meals.stored.job_models import Job
from tests.integration.jobs.fakes import new_unqueued_job


@pytest.fixture
def line(jobs):
    return Line(jobs)


class Line:
    """Waiting jobs, taken one after the other as workers would."""

    def __init__(self, jobs):
        self.jobs = jobs

    def send(self, phone, count=1):
        with self.jobs.database.write() as session:
            return [self._queue(session, phone) for _ in range(count)]

    def _queue(self, session, phone):
        job, _ = new_unqueued_job(session, device_id=phone)
        self.jobs.queue.enqueue(session, job)
        return job.id

    def take(self):
        """The job that a worker claims next, begun as a worker does; None: nothing waits."""
        with self.jobs.database.write() as session:
            claimed = claim_jobs(session, "somebody", protocol=1, room=1)
            if not claimed:
                return None
            job = session.get_one(Job, claimed[0])
            job.state, job.started_at, job.finished_at = "done", job.enqueued_at, job.enqueued_at
            return job.id

    def take_up_to(self, wanted):
        """The number of others that are taken before it."""
        taken = 0
        while (job_id := self.take()) != wanted:
            assert job_id is not None
            taken += 1
        return taken


def test_first_meal_of_a_study_is_next_whatever_waits_and_two_backlogs_take_turns_without_any_saved_up(line, jobs):
    early, late = jobs.new_study(), jobs.new_study()
    backlog = line.send(early, 60)
    for _ in range(20):
        assert line.take() in backlog
    assert line.take_up_to(line.send(late)[0]) == 0
    for _ in range(6):  # while the other one is quiet
        assert line.take() in backlog
    second = line.send(late, 24)
    order = [line.take() for _ in range(24)]
    assert sum(job_id in second for job_id in order) == pytest.approx(12, abs=1)
    of_first = [job_id for job_id in order if job_id in backlog]
    assert of_first == backlog[26 : 26 + len(of_first)]  # first come, first served within the study


@pytest.mark.both_stores
def test_uploads_that_do_not_see_each_other_get_turns_of_their_own_and_another_process_goes_on_from_them(jobs):
    """As when a process writes many at once: none sees what the others have not committed."""
    phone, given = jobs.new_study(), []
    for _ in range(5):
        with pytest.raises(RuntimeError), jobs.database.write() as session:  # noqa: PT012
            job, _ = new_unqueued_job(session, device_id=phone)
            jobs.queue.enqueue(session, job)
            given.append(job.turn)
            raise RuntimeError
    assert given == [1, 2, 3, 4, 5]
    first = jobs.add(device_id=phone)
    with jobs.database.write() as session:
        job, _ = new_unqueued_job(session, device_id=phone)
        JobQueue().enqueue(session, job)
        assert job.turn == jobs.job(first).turn + 1 == 7


def test_job_that_is_queued_again_keeps_its_turn(line, jobs):
    phone = jobs.new_study()
    lost, *_ = line.send(phone, 50)
    before = jobs.job(lost).turn
    jobs.change(lost, executor_id="somebody")
    with jobs.database.write() as session:
        assert release_claims(session, "somebody", is_takeover=True) == 1
    with jobs.database.write() as session:
        jobs.queue.enqueue(session, session.get_one(Job, lost))
    assert jobs.job(lost).turn == before
    assert line.take() == lost


@pytest.mark.both_stores
def test_jobs_of_one_turn_are_taken_in_the_order_in_which_they_came(line, jobs):
    """Several processes may give a turn once each."""
    first, second, third = (line.send(jobs.new_study())[0] for _ in range(3))
    with jobs.database.write() as session:
        session.execute(sa.update(Job).values(turn=2**31 + 7))
    assert [line.take(), line.take(), line.take()] == [first, second, third]
    assert jobs.job(line.send(jobs.new_study())[0]).turn > 2**31


@pytest.mark.both_stores
def test_turns_are_looked_up_in_indexes(jobs):
    """With a million old jobs each question is one step into an index; here: the planner's word that it uses them."""
    phone = jobs.new_study()
    jobs.add(device_id=phone)
    plans = []
    with jobs.database.write() as session:
        if not jobs.database.is_sqlite:
            session.execute(sa.text("SET LOCAL enable_seqscan = off"))  # with a handful of rows it would read them all
        explain = "EXPLAIN QUERY PLAN" if jobs.database.is_sqlite else "EXPLAIN"
        for query in (
            "SELECT max(turn) FROM job WHERE study_id = (SELECT id FROM study LIMIT 1)",
            "SELECT max(turn) FROM job WHERE started_at IS NOT NULL",
            (
                "SELECT id FROM job WHERE executor_id IS NULL AND finished_at IS NULL AND is_background = false "
                "ORDER BY is_background, turn, enqueued_at, id LIMIT 2"
            ),
            "SELECT DISTINCT executor_id FROM job WHERE finished_at IS NULL AND executor_id IS NOT NULL",
        ):
            rows = session.execute(sa.text(f"{explain} {query}")).all()
            plans.append(" ".join(str(row) for row in rows))
    assert "ix_job_study_id_turn" in plans[0]
    assert "ix_job_turn_of_begun" in plans[1]
    assert "ix_job_waiting" in plans[2]
    assert "sort" not in plans[2].lower()
    assert "TEMP B-TREE" not in plans[2]
    assert "ix_job_claimed" in plans[3]


def test_job_with_a_fault_is_put_off_for_half_the_time_that_it_lasts_and_by_no_clock_that_was_ahead(line, jobs):
    (job_id,) = line.send(jobs.new_study())
    now = datetime.now(UTC)

    def seconds_put_off(lasted):
        jobs.change(job_id, executor_id="somebody", faulty_since=now - timedelta(seconds=lasted))
        with jobs.database.write() as session:
            put_off(session, job_id, "somebody", now, WorkerTimes(first_wait=0.5, longest_wait=30.0))
            return (session.get_one(Job, job_id).not_before - now).total_seconds()

    assert [seconds_put_off(lasted) for lasted in (0, 20, 600)] == [0.5, 10, 30]
    jobs.change(job_id, not_before=datetime.now(UTC) + LONGEST_PUT_OFF * 0.9)
    assert line.take() is None
    jobs.change(job_id, not_before=datetime.now(UTC) + LONGEST_PUT_OFF * 2)
    assert line.take() == job_id
