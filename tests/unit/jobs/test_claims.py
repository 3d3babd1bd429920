import threading
from concurrent.futures import Future

import pytest

from app.jobs import claims
from app.jobs.claims import Claims


class FakeSystemDatabase:
    """What waits, and what was asked for."""

    def __init__(self, waiting):
        self.waiting, self.asked = waiting, []
        self.was_asked = threading.Semaphore(0)

    def start_queued_workflows(self, queue, executor, version, partition, running, *, owner_xid, is_latest_version):
        room = queue._worker_concurrency - running
        self.asked.append((version, room))
        self.was_asked.release()
        taken = [one for one in self.waiting if one[0] == version][:room]
        for one in taken:
            self.waiting.remove(one)
        return [name for _, name in taken], None

    def get_workflow_statuses(self, ids):
        return [{"workflow_uuid": name} for name in ids]


class FakeDbos:
    def __init__(self, waiting):
        self._sys_db = FakeSystemDatabase(waiting)
        self.begun = {}
        self.has_begun = threading.Semaphore(0)

    def begin(self, _, status, token):
        name = status["workflow_uuid"]
        future = Future()
        self.begun[name] = future
        self.has_begun.release()
        return claims.WorkflowHandleFuture(name, future, None)


@pytest.fixture
def engine(monkeypatch):
    """Claims that look only when something ends, after their first look."""
    monkeypatch.setattr(claims, "POLL_SECONDS", 60.0)
    started = []

    def start(waiting, concurrency=2, versions=("1",)):
        dbos = FakeDbos(list(waiting))
        monkeypatch.setattr(claims, "execute_dequeued_workflow", dbos.begin)
        found = Claims(dbos, "q", "e", concurrency=concurrency, versions=versions)
        found.start()
        started.append(found)
        return dbos

    yield start
    for one in started:
        one.stop()


def wait_for(semaphore, times=1):
    for _ in range(times):
        assert semaphore.acquire(timeout=20)


def test_no_more_is_claimed_than_there_is_room_for_and_the_next_as_soon_as_one_ends(engine):
    dbos = engine([("1", name) for name in "abcd"])
    wait_for(dbos.has_begun, 2)
    assert sorted(dbos.begun) == ["a", "b"]
    dbos.begun["b"].set_result("done")
    wait_for(dbos.has_begun)
    assert sorted(dbos.begun) == ["a", "b", "c"]


def test_job_that_ends_badly_makes_room_too(engine):
    dbos = engine([("1", "a"), ("1", "b")], concurrency=1)
    wait_for(dbos.has_begun)
    dbos.begun["a"].set_exception(KeyError("a bug"))
    wait_for(dbos.has_begun)
    assert "b" in dbos.begun


def test_job_that_cannot_be_begun_keeps_no_room(engine, monkeypatch):
    dbos = engine([], concurrency=1)
    wait_for(dbos._sys_db.was_asked)
    begin, failed = dbos.begin, threading.Semaphore(0)

    def give_up(*arguments):
        failed.release()
        monkeypatch.setattr(claims, "execute_dequeued_workflow", begin)
        raise RuntimeError("given up")

    other = engine([("1", "a"), ("1", "b")], concurrency=1)
    wait_for(other.has_begun)
    monkeypatch.setattr(claims, "execute_dequeued_workflow", give_up)
    other._sys_db.waiting.append(("1", "c"))
    other.begun["a"].set_result("done")
    wait_for(failed)
    wait_for(dbos.has_begun)  # by the first engine's fake: the patch is the module's
    assert "c" in dbos.begun


def test_jobs_of_all_versions_are_claimed_into_one_room(engine):
    dbos = engine([("1", "old"), ("2", "new"), ("1", "older"), ("3", "newest")], concurrency=3, versions=("1", "2"))
    wait_for(dbos.has_begun, 3)
    assert sorted(dbos.begun) == ["new", "old", "older"]


def test_database_that_does_not_answer_is_asked_again(engine, monkeypatch):
    monkeypatch.setattr(claims, "POLL_SECONDS", 0.01)
    calls = threading.Semaphore(0)

    def away(self, *_, **__):
        calls.release()
        raise ConnectionError

    monkeypatch.setattr(FakeSystemDatabase, "start_queued_workflows", away)
    engine([("1", "a")])
    wait_for(calls, 3)
