"""What a worker claims, and when. A list of jobs stands for the database; tests/integration/jobs have the real one."""

import contextlib
import threading
import uuid

import pytest

from app.children.faults import JobLeft
from app.jobs import claims
from app.jobs.claims import Claims


class FakeDatabase:
    """Jobs that wait, as (protocol, id), and which were claimed."""

    def __init__(self, waiting=()):
        self.waiting = list(waiting)
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
        self.has_begun = threading.Semaphore(0)
        self._ends = {}

    def __call__(self, job_id):
        end = self._ends.setdefault(job_id, [threading.Event(), None])
        self.begun.append(job_id)
        self.has_begun.release()
        end[0].wait(20)
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
    monkeypatch.setattr(
        claims.jobs, "is_any_waiting", lambda found, protocol: any(least <= protocol for least, _ in found.waiting)
    )

    def claim(database, executor_id, *, protocol, room):
        taken = [job for job in database.waiting if job[0] <= protocol][:room]
        database.waiting = [job for job in database.waiting if job not in taken]
        return [job_id for _, job_id in taken]

    monkeypatch.setattr(claims.jobs, "claim_jobs", claim)
    started = []

    def start(database, *, concurrency=2, protocol=1, lease=None):
        runs = Runs()
        claiming = Claims(database, lease or FakeLease(), runs, concurrency=concurrency, protocol=protocol)
        claiming.start()
        started.append((claiming, runs))
        return claiming, runs

    yield start
    for claiming, runs in started:
        claiming.stop()
        runs.end_all()


def wait_for(semaphore, times=1):
    for _ in range(times):
        assert semaphore.acquire(timeout=20)


def ids(count):
    return [uuid.UUID(int=number) for number in range(1, count + 1)]


def test_no_more_is_claimed_than_there_is_room_for_and_the_next_as_soon_as_a_job_ends(start):
    first, second, third, _ = ids(4)
    _, runs = start(FakeDatabase((1, job_id) for job_id in ids(4)))
    wait_for(runs.has_begun, 2)
    assert sorted(runs.begun) == [first, second]
    runs.end(second)
    wait_for(runs.has_begun)
    assert sorted(runs.begun) == [first, second, third]


@pytest.mark.parametrize("error", [KeyError("a bug"), JobLeft()])
def test_job_that_ends_badly_makes_room_too(start, error):
    first, second = ids(2)
    _, runs = start(FakeDatabase([(1, first), (1, second)]), concurrency=1)
    wait_for(runs.has_begun)
    runs.end(first, error)
    wait_for(runs.has_begun)
    assert runs.begun == [first, second]


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


def test_jobs_of_a_newer_protocol_are_left_alone(start):
    old, newer, older = ids(3)
    _, runs = start(FakeDatabase([(1, old), (3, newer), (2, older)]), concurrency=3, protocol=2)
    wait_for(runs.has_begun, 2)
    assert sorted(runs.begun) == [old, older]


def test_worker_that_has_lost_its_lease_claims_nothing(start):
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
