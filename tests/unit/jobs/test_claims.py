"""What a worker claims, and when. A list of jobs stands for the database; tests/integration/jobs have the real one."""

import contextlib
import threading
import uuid

import pytest

from app.children.faults import JobLeft
from app.jobs import claims
from app.jobs.claims import Claims, no_backlog
from tests.support.waiting import PATIENCE_SECONDS


class FakeDatabase:
    """Jobs that wait, as (protocol, id). background: those of them that are background jobs."""

    def __init__(self, waiting=(), background=()):
        self.waiting = list(waiting)
        self.background = set(background)
        self.looked = threading.Semaphore(0)

    @contextlib.contextmanager
    def read(self):
        self.looked.release()
        yield self

    write = read


class FakeLease:
    executor_id = "me"
    is_lost = False

    def guard(self, session):
        if self.is_lost:
            raise JobLeft


class Runs:
    """Jobs that run until they are told to end."""

    def __init__(self):
        self.begun = []
        self.abandoned = []
        self.has_begun = threading.Semaphore(0)
        self._ends = {}

    def __call__(self, job_id):
        end = self._ends.setdefault(job_id, [threading.Event(), None])
        self.begun.append(job_id)
        self.has_begun.release()
        end[0].wait(PATIENCE_SECONDS)
        if end[1] is not None:
            raise end[1]

    def end(self, job_id, error=None):
        end = self._ends[job_id]
        end[1] = error
        end[0].set()

    def end_all(self):
        for end, _ in self._ends.values():
            end.set()


@pytest.fixture
def start(monkeypatch):
    """Starts claims that look only when something ends, after their first look."""
    monkeypatch.setattr(claims, "POLL_SECONDS", 60.0)

    def kind(database, protocol):
        kinds = {job_id in database.background for least, job_id in database.waiting if least <= protocol}
        return None if not kinds else "ordinary" if False in kinds else "background"

    def claim(database, executor_id, *, protocol, room, is_background, but):
        fits = [job for job in database.waiting if job[0] <= protocol and job[1] not in but]
        taken = [job for job in fits if (job[1] in database.background) == is_background][:room]
        database.waiting = [job for job in database.waiting if job not in taken]
        return [job_id for _, job_id in taken]

    def release(database, executor_id, job_ids, *, is_takeover):
        assert not is_takeover
        database.waiting += [(1, job_id) for job_id in job_ids]
        return len(job_ids)

    monkeypatch.setattr(claims.jobs, "waiting_kind", kind)
    monkeypatch.setattr(claims.jobs, "claim_jobs", claim)
    monkeypatch.setattr(claims.jobs, "release_claims", release)
    started = []

    def start(database, *, concurrency=2, protocol=1, lease=None, backlog=no_backlog):
        runs = Runs()
        claiming = Claims(
            database,
            lease or FakeLease(),
            runs,
            concurrency=concurrency,
            protocol=protocol,
            backlog=backlog,
            abandon=runs.abandoned.append,
        )
        claiming.start()
        started.append((claiming, runs))
        return claiming, runs

    yield start
    for claiming, runs in started:
        claiming.stop()
        runs.end_all()


def wait_for(semaphore, times=1):
    for _ in range(times):
        assert semaphore.acquire(timeout=PATIENCE_SECONDS)


def ids(count):
    return [uuid.UUID(int=number) for number in range(1, count + 1)]


@pytest.mark.parametrize("error", [None, KeyError("a bug"), JobLeft()])
def test_no_more_is_claimed_than_there_is_room_for_and_the_next_as_soon_as_a_job_ends_well_or_badly(start, error):
    first, second, third, _ = ids(4)
    _, runs = start(FakeDatabase((1, job_id) for job_id in ids(4)))
    wait_for(runs.has_begun, 2)
    assert sorted(runs.begun) == [first, second]
    runs.end(second, error)
    wait_for(runs.has_begun)
    assert sorted(runs.begun) == [first, second, third]


def test_next_job_is_claimed_while_one_that_is_computed_is_saved_but_results_do_not_pile_up(start):
    first, second, _ = ids(3)
    database = FakeDatabase((1, job_id) for job_id in ids(3))
    claiming, runs = start(database, concurrency=1)
    wait_for(runs.has_begun)
    claiming.note_computed(str(first))
    wait_for(runs.has_begun)
    claiming.note_computed(str(second))
    wait_for(database.looked, 4)  # two claims, each after a look
    assert runs.begun == [first, second]


def test_job_that_needs_its_child_again_takes_its_room_back(start):
    first, _ = ids(2)
    database = FakeDatabase([(1, first)])
    claiming, runs = start(database, concurrency=1)
    wait_for(runs.has_begun)
    claiming.note_computing(str(first))
    database.waiting.append((1, ids(2)[1]))
    claiming._claim_up_to_capacity()
    assert runs.begun == [first]


def test_jobs_of_a_newer_protocol_are_left_alone_and_all_by_a_worker_that_has_lost_its_lease(start):
    old, newer, same = ids(3)
    _, runs = start(FakeDatabase([(1, old), (3, newer), (2, same)]), concurrency=3, protocol=2)
    wait_for(runs.has_begun, 2)
    assert sorted(runs.begun) == [old, same]
    lease, database = FakeLease(), FakeDatabase([(1, ids(1)[0])])
    lease.is_lost = True
    _, runs = start(database, lease=lease)
    wait_for(database.looked, 2)
    assert (runs.begun, len(database.waiting)) == ([], 1)


def test_database_that_does_not_answer_is_asked_again(start, monkeypatch):
    monkeypatch.setattr(claims, "POLL_SECONDS", 0.01)
    database, calls = FakeDatabase(), threading.Semaphore(0)

    def away():
        calls.release()
        raise ConnectionError

    database.read = away
    start(database)
    wait_for(calls, 3)


def backlog_of(database, job_ids):
    """A backlog that queues these background jobs, in their order, as there is room for them."""
    left = list(job_ids)

    def queue(room):
        queued, left[:] = left[:room], left[room:]
        database.background.update(queued)
        database.waiting += [(1, job_id) for job_id in queued]
        return len(queued)

    return queue


def test_background_jobs_are_queued_and_run_while_nothing_else_waits_on_all_cores_but_one(start):
    database = FakeDatabase()
    _, runs = start(database, concurrency=3, backlog=backlog_of(database, ids(4)))
    wait_for(runs.has_begun, 2)
    assert sorted(runs.begun) == ids(2)
    runs.end(ids(1)[0])
    wait_for(runs.has_begun)
    assert sorted(runs.begun) == ids(3)


def test_waiting_meal_is_claimed_before_any_background_job_and_takes_the_core_that_they_leave_free(start):
    meal, rerun = ids(2)
    _, runs = start(FakeDatabase([(1, rerun), (1, meal)], background=[rerun]), concurrency=1)
    wait_for(runs.has_begun)
    assert runs.begun == [meal]
    database = FakeDatabase()
    claiming, runs = start(database, concurrency=2, backlog=backlog_of(database, [rerun]))
    wait_for(runs.has_begun)
    database.waiting.append((1, meal))
    claiming._claim_up_to_capacity()
    wait_for(runs.has_begun)
    assert (runs.begun, runs.abandoned) == ([rerun, meal], [])


def test_meal_that_finds_every_core_busy_ends_a_background_job_which_goes_back_and_runs_again(start):
    rerun, meal = ids(2)
    database = FakeDatabase()
    claiming, runs = start(database, concurrency=1, backlog=backlog_of(database, [rerun]))
    wait_for(runs.has_begun)
    database.waiting.append((1, meal))
    claiming._claim_up_to_capacity()
    assert (runs.abandoned, database.waiting) == ([rerun], [(1, meal), (1, rerun)])
    claiming._claim_up_to_capacity()  # it is still ending: it is told again, and nothing else is handed back
    assert (runs.abandoned, runs.begun) == ([rerun, rerun], [rerun])
    runs.end(rerun)
    wait_for(runs.has_begun)
    assert runs.begun == [rerun, meal]
    runs.end(meal)
    wait_for(runs.has_begun)
    assert runs.begun == [rerun, meal, rerun]


def test_background_job_whose_result_is_being_saved_is_not_ended(start):
    rerun, meal = ids(2)
    database = FakeDatabase()
    claiming, runs = start(database, concurrency=1, backlog=backlog_of(database, [rerun]))
    wait_for(runs.has_begun)
    claiming.note_computed(str(rerun))
    database.waiting.append((1, meal))
    claiming._claim_up_to_capacity()
    wait_for(runs.has_begun)
    assert (runs.begun, runs.abandoned) == ([rerun, meal], [])
