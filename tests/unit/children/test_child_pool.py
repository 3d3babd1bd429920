import contextlib
import errno
import os
import pathlib
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from app.children.child_pool import ChildCancelledError, ChildPool, ChildPoolClosedError, ChildRequest, ChildStartError
from app.core.settings import Settings
from tests.support.waiting import PATIENCE_SECONDS, wait_until

ROOT = pathlib.Path(__file__).parents[3]
TASKS = "tests.unit.children.fake_tasks:TASKS"
ENOUGH_BYTES = 512 * 1024 * 1024


@pytest.fixture
def settings(tmp_path):
    return Settings(data_dir=tmp_path, estimate_seconds=30, estimate_memory_bytes=ENOUGH_BYTES)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """One child, taken over by the next test while it lasts."""
    settings = Settings(
        data_dir=tmp_path_factory.mktemp("pool"), estimate_seconds=30, estimate_memory_bytes=ENOUGH_BYTES
    )
    pool = ChildPool(settings, TASKS)
    yield pool
    pool.close()


@pytest.fixture
def pool_of(settings):
    """Makes a pool of the test's own."""
    with contextlib.ExitStack() as pools:

        def make(**changes):
            pool = ChildPool(settings, TASKS, **changes)
            pools.callback(pool.close)
            return pool

        yield make


def run(pool, task, seconds=None, **arguments):
    """With so much patience by the clock that only the limit of processor time counts, whatever else runs."""
    return pool.run(ChildRequest(task, arguments), lambda _: None, seconds=seconds, patience=PATIENCE_SECONDS)


class Hanging(threading.Thread):
    """A request that hangs in its child until the pool ends it. error: what it raised."""

    def __init__(self, pool, name=None):
        super().__init__()
        self._pool, self._request_name, self._begun, self.error = pool, name, threading.Event(), None
        self.start()
        assert self._begun.wait(PATIENCE_SECONDS)

    def run(self):
        try:
            self._pool.run(ChildRequest("hang", {}), lambda _: self._begun.set(), name=self._request_name)
        except (ChildCancelledError, ChildPoolClosedError) as error:
            self.error = error


@pytest.mark.parametrize(
    ("task", "outcome", "code", "number"),
    [
        ("segfault", "crashed", "estimate_crashed", signal.SIGSEGV),
        ("exit", "crashed", "estimate_crashed", None),
        ("eat_memory", "out_of_memory", "estimate_out_of_memory", None),
        ("killed", "killed", "estimate_killed", None),
        ("raise", "raised", "internal_error", None),
        ("not_json", "raised", "internal_error", None),
        ("garble", "raised", "internal_error", None),
        ("no_such_task", "raised", "internal_error", None),
        ("fill_disk", "raised", "internal_error", errno.ENOSPC),  # which is waited for, and no mistake of the program
    ],
)
def test_bad_end_is_a_value_with_its_code_and_the_next_request_runs(pool, task, outcome, code, number):
    ended = run(pool, task)
    assert ended.outcome == outcome
    assert ended.failure.code == code
    assert (ended.signal or ended.errno) == number
    assert run(pool, "describe", word="é").result["echo"] == {"word": "é"}


def test_child_that_hangs_is_killed_at_the_limit_of_the_clock(pool):
    """It is not the limit of processor time: 120 s of the clock failed meals on a machine under load."""
    run(pool, "describe")  # it is warm

    for limit in (1, 2, 4, 8):  # s
        stages = []
        ended = pool.run(ChildRequest("hang", {}), stages.append, seconds=limit / 2, patience=2.0)
        assert (ended.outcome, ended.failure.code) == ("stalled", "estimate_timed_out")
        assert f"within {limit} s" in ended.failure.message
        if stages:  # otherwise a loaded machine needed longer to begin
            break
    assert stages == ["hanging"]


def test_child_that_computes_too_long_is_ended_by_its_processor_time(pool):
    ended = run(pool, "spin", seconds=1.0)
    assert (ended.outcome, ended.failure.code) == ("timed_out", "estimate_timed_out")
    assert "more than 1 s of processor time" in ended.failure.message
    assert run(pool, "describe").outcome == "ok"


def test_request_that_runs_alone_has_no_child_beside_it(pool_of, tmp_path):
    pool = pool_of(children=2)
    end, holding, order = tmp_path / "end", threading.Event(), []

    def hold():
        pool.run(ChildRequest("hold", {"until": str(end)}), lambda _: holding.set())
        order.append("beside")

    def alone():
        pool.run(ChildRequest("describe", {}), lambda _: None, is_alone=True)
        order.append("alone")

    threads = [threading.Thread(target=hold)]
    try:
        threads[0].start()
        assert holding.wait(PATIENCE_SECONDS)
        threads += [threading.Thread(target=alone), threading.Thread(target=alone)]
        for thread in threads[1:]:
            thread.start()
        wait_until(lambda: pool._gathering.locked() and pool._free._value == 0, "the first to gather all places")
        assert order == []
        end.touch()
        for thread in threads:
            thread.join(PATIENCE_SECONDS)
        assert order == ["beside", "alone", "alone"]
    finally:
        end.touch()


def test_stages_arrive_in_order_standard_input_is_empty_and_what_libraries_print_does_not_reach_the_answer(pool):
    stages = []
    ended = pool.run(ChildRequest("stages", {"names": ["read", "match", "volume"]}), stages.append)
    assert ended.result == {"read": ""}
    assert stages == ["read", "match", "volume"]
    assert run(pool, "print").result == {"who": "the task"}


def test_child_sees_no_setting_and_no_password(pool_of, monkeypatch):
    monkeypatch.setenv("TADA_DATABASE_URL", "postgresql://user:secret@host/tada")
    monkeypatch.setenv("PGPASSWORD", "secret")
    names = run(pool_of(), "describe").result["environment"]
    assert not [name for name in names if name.startswith(("TADA_", "PG"))]


def test_warm_child_is_used_again_until_it_had_its_share(pool_of):
    pool = pool_of(uses=3)
    pids = [run(pool, "describe").result["pid"] for _ in range(4)]
    assert pids[0] == pids[1] == pids[2] != pids[3]


def test_child_that_died_while_it_waited_or_whose_listener_failed_is_replaced(pool):
    first = run(pool, "describe").result["pid"]
    os.kill(first, signal.SIGKILL)
    second = run(pool, "describe").result["pid"]

    def listener(stage):
        raise OSError(stage)

    with pytest.raises(OSError, match="read"):
        pool.run(ChildRequest("stages", {"names": ["read"]}), listener)
    assert len({first, second, run(pool, "describe").result["pid"]}) == 3


def test_child_that_cannot_start_raises(settings):
    pool = ChildPool(settings, "tests.unit.children.fake_tasks:NOTHING")
    with pytest.raises(ChildStartError):
        run(pool, "describe")
    pool.close()


def test_cancelled_request_raises_its_child_is_ended_and_the_next_request_runs(pool):
    hanging = Hanging(pool, "a job")
    assert pool.cancel("another job") is False
    assert pool.cancel("a job") is True
    hanging.join(PATIENCE_SECONDS)
    assert isinstance(hanging.error, ChildCancelledError)
    assert run(pool, "describe").outcome == "ok"
    assert pool.cancel("a job") is False


def test_warm_children_are_as_many_as_there_may_be_and_are_the_ones_that_work(pool_of):
    pool = pool_of(children=2)
    pool.warm_up()
    pool.warm_up()
    warm = {child._process.pid for child in pool._alive}
    assert len(warm) == 2
    with ThreadPoolExecutor(4) as threads:
        results = list(threads.map(lambda _: run(pool, "describe"), range(24)))
    assert {ended.outcome for ended in results} == {"ok"}
    assert {ended.result["pid"] for ended in results} <= warm  # none was ended under another's request


def test_closing_ends_a_running_request_and_refuses_the_next(pool_of):
    pool = pool_of()
    hanging = Hanging(pool)
    pool.close()
    hanging.join(PATIENCE_SECONDS)
    assert isinstance(hanging.error, ChildPoolClosedError)
    with pytest.raises(ChildPoolClosedError):
        run(pool, "describe")


def test_children_die_with_a_parent_that_is_killed(tmp_path):
    script = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from app.children.child_pool import ChildPool, ChildRequest
from app.core.settings import Settings
pool = ChildPool(Settings(data_dir={str(tmp_path)!r}), {TASKS!r})
print(pool.run(ChildRequest("describe", {{}}), print).result["pid"], flush=True)
pool.run(ChildRequest("hang", {{}}), print)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, cwd=tmp_path) as parent:
        child = int(parent.stdout.readline())
        assert is_running(child)
        parent.kill()
    wait_until(lambda: not is_running(child), "the child to die")


def is_running(pid):
    """Also a zombie has ended: nobody may be there to collect it."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_costly_request_gives_way_and_the_next_one_in_its_child_does_not(pool):
    before = run(pool, "describe").result
    costly = pool.run(ChildRequest("describe", {}, is_costly=True), lambda _: None).result
    after = run(pool, "describe").result
    assert before["pid"] == costly["pid"] == after["pid"]
    assert costly["niceness"] > before["niceness"] == after["niceness"]
