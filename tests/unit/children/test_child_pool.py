import errno
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

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


@pytest.fixture
def pool(settings, monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    found = ChildPool(settings, TASKS, uses=3)
    yield found
    found.close()


def run(pool, task, seconds=None, **arguments):
    """With so much patience by the clock that only the limit of processor time counts, whatever else runs."""
    return pool.run(ChildRequest(task, arguments), lambda _: None, seconds=seconds, patience=PATIENCE_SECONDS)


@pytest.mark.parametrize(
    ("task", "outcome", "code"),
    [
        ("segfault", "crashed", "estimate_crashed"),
        ("exit", "crashed", "estimate_crashed"),
        ("eat_memory", "out_of_memory", "estimate_out_of_memory"),
        ("killed", "killed", "estimate_killed"),
        ("raise", "raised", "internal_error"),
        ("not_json", "raised", "internal_error"),
        ("garble", "raised", "internal_error"),
        ("no_such_task", "raised", "internal_error"),
    ],
)
def test_bad_end_is_a_value_with_its_code_and_the_next_request_runs(pool, task, outcome, code):
    ended = run(pool, task)
    assert ended.outcome == outcome
    assert ended.failure.code == code
    assert run(pool, "describe", word="é").result["echo"] == {"word": "é"}


def test_signal_of_a_crash_is_told(pool):
    assert run(pool, "segfault").signal == signal.SIGSEGV


def test_child_that_hangs_is_killed_at_the_limit_of_the_clock(pool):
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


def test_busy_machine_does_not_time_out_a_child_that_has_had_little_of_the_processor(pool, tmp_path):
    """It was 120 s of the clock that failed meals on a machine under load."""
    end = tmp_path / "end"
    threading.Timer(1.5, end.touch).start()
    assert run(pool, "hold", seconds=1.0, until=str(end)).outcome == "ok"


def test_limit_of_processor_time_counts_for_each_request_anew(pool):
    def spin_a_little():
        return run(pool, "spin_for", seconds=2.0, cpu_seconds=1.2)

    pids = [spin_a_little().result["pid"] for _ in range(3)]
    assert len(set(pids)) == 1


def test_request_that_runs_alone_has_no_child_beside_it(settings, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(ROOT)
    pool = ChildPool(settings, TASKS, children=2)
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
        time.sleep(0.3)
        assert order == []
        end.touch()
        for thread in threads:
            thread.join(PATIENCE_SECONDS)
        assert sorted(order) == ["alone", "alone", "beside"]
        assert order[0] == "beside"
    finally:
        end.touch()
        pool.close()


def test_stages_arrive_in_order_and_standard_input_is_empty(pool):
    stages = []
    ended = pool.run(ChildRequest("stages", {"names": ["read", "match", "volume"]}), stages.append)
    assert ended.result == {"read": ""}
    assert stages == ["read", "match", "volume"]


def test_what_libraries_print_does_not_reach_the_answer(pool):
    assert run(pool, "print").result == {"who": "the task"}


def test_child_sees_no_setting_and_no_password(pool, monkeypatch):
    monkeypatch.setenv("TADA_DATABASE_URL", "postgresql://user:secret@host/tada")
    monkeypatch.setenv("PGPASSWORD", "secret")
    names = run(pool, "describe").result["environment"]
    assert not [name for name in names if name.startswith(("TADA_", "PG"))]


def test_warm_child_is_used_again_until_it_had_its_share(pool):
    pids = [run(pool, "describe").result["pid"] for _ in range(4)]
    assert pids[0] == pids[1] == pids[2] != pids[3]


def test_child_that_died_while_it_waited_is_replaced(pool):
    pid = run(pool, "describe").result["pid"]
    os.kill(pid, signal.SIGKILL)
    assert run(pool, "describe").result["pid"] != pid


def test_fault_of_the_listener_reaches_the_caller_and_the_child_is_not_used_again(pool):
    def listener(stage):
        raise OSError(stage)

    first = run(pool, "describe").result["pid"]
    with pytest.raises(OSError, match="read"):
        pool.run(ChildRequest("stages", {"names": ["read"]}), listener)
    assert run(pool, "describe").result["pid"] != first


def test_child_that_cannot_start_raises(settings):
    pool = ChildPool(settings, "tests.unit.children.fake_tasks:NOTHING")
    with pytest.raises(ChildStartError):
        run(pool, "describe")
    pool.close()


def test_cancelled_request_raises_its_child_is_ended_and_the_next_request_runs(pool):
    hanging, ended = threading.Event(), []

    def wait_for_it():
        try:
            pool.run(ChildRequest("hang", {}), lambda _: hanging.set(), name="a job")
        except ChildCancelledError as error:
            ended.append(error)

    thread = threading.Thread(target=wait_for_it)
    thread.start()
    assert hanging.wait(PATIENCE_SECONDS)
    assert pool.cancel("another job") is False
    assert pool.cancel("a job") is True
    thread.join(PATIENCE_SECONDS)
    assert len(ended) == 1
    assert run(pool, "describe").outcome == "ok"
    assert pool.cancel("a job") is False


def test_requests_that_come_while_the_pool_warms_up_start_no_child_more_than_there_may_be(settings, monkeypatch):
    """Held up in its thread, the starter has the request's wish behind that of the warming up."""
    monkeypatch.syspath_prepend(ROOT)
    pool = ChildPool(settings, TASKS)
    go_on = threading.Event()
    pool._starter.submit(go_on.wait)
    threads = [threading.Thread(target=pool.warm_up), threading.Thread(target=run, args=(pool, "describe"))]
    try:
        for waiting, thread in enumerate(threads, start=1):
            thread.start()
            wait_until(lambda count=waiting: pool._starter._work_queue.qsize() == count, "its wish for a child")
        go_on.set()
        for thread in threads:
            thread.join(PATIENCE_SECONDS)
        assert len(pool._alive) == 1
    finally:
        go_on.set()
        pool.close()


def test_warm_children_are_as_many_as_there_may_be_and_are_the_ones_that_work(settings, monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    pool = ChildPool(settings, TASKS, children=3)
    try:
        pool.warm_up()
        pool.warm_up()
        warm = {child._process.pid for child in pool._alive}
        assert len(warm) == 3
        pids, outcomes = set(), []

        def work():
            for _ in range(10):
                ended = run(pool, "describe")
                outcomes.append(ended.outcome)
                pids.add(ended.result["pid"])

        threads = [threading.Thread(target=work) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE_SECONDS)
        assert outcomes == ["ok"] * 60
        assert pids <= warm  # none was ended under another's request
    finally:
        pool.close()


def test_closing_ends_a_running_request_and_refuses_the_next(pool):
    hanging, ended = threading.Event(), []

    def wait_for_it():
        try:
            pool.run(ChildRequest("hang", {}), lambda _: hanging.set())
        except ChildPoolClosedError as error:
            ended.append(error)

    thread = threading.Thread(target=wait_for_it)
    thread.start()
    assert hanging.wait(PATIENCE_SECONDS)
    pool.close()
    thread.join(PATIENCE_SECONDS)
    assert len(ended) == 1
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


def test_what_the_system_refused_comes_with_its_number(pool):
    """So that a full disk is waited for, and is no mistake of the program."""
    ended = run(pool, "fill_disk")
    assert (ended.outcome, ended.errno) == ("raised", errno.ENOSPC)
    assert run(pool, "raise").errno is None
