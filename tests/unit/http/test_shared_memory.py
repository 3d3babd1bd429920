"""Limits that forked processes share: each test forks real processes of its own."""

import os
import signal
import time

import pytest

from app.core.errors import RateLimitedError
from app.core.settings import Settings
from app.http.rate_limit import CallLimits, RateLimit
from app.http.shared_memory import MAX_KEYS, ActiveCounts, KeyTable, shared_lock


def in_child(work):
    """Fork, do the work in the child, which then waits to be ended; its process id, once the work is done."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            work()
            os.write(writer, b"1")
            time.sleep(60)
        finally:
            os._exit(1)
    os.close(writer)
    is_done = os.read(reader, 1) == b"1"
    os.close(reader)
    if not is_done:
        os.waitpid(pid, 0)
        raise AssertionError("the child failed")
    return pid


def end(pid):
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def passes(limit, calls):
    def is_let_in():
        try:
            limit.take("a")
        except RateLimitedError:
            return False
        return True

    return sum(is_let_in() for _ in range(calls))


def test_processes_at_the_same_time_pass_exactly_the_limit():
    limit = RateLimit(500, lambda: 0.0)
    counts = [os.pipe() for _ in range(3)]
    pids = []
    for _, writer in counts:
        pids.append(os.fork())
        if pids[-1] == 0:
            try:
                os.write(writer, str(passes(limit, 400)).encode())
            finally:
                os._exit(0)
    for pid in pids:
        os.waitpid(pid, 0)
    found = [int(os.read(reader, 10)) for reader, _ in counts]
    for pipe in counts:
        for end_of_pipe in pipe:
            os.close(end_of_pipe)
    assert sum(found) == 500


def test_lock_of_a_killed_process_is_free_again():
    lock = shared_lock()
    pid = in_child(lock.__enter__)
    end(pid)
    with lock:
        pass


def test_requests_of_all_processes_count_for_an_address_until_their_process_is_dead_and_cleared():
    limits = CallLimits(Settings(max_connections_per_address=3), lambda: 0.0, processes=2)

    def begin_two():
        limits.active.become(1)
        for _ in range(2):
            under_way.append(limits.under_way("192.0.2.1", "call"))
            under_way[-1].__enter__()

    under_way = []

    pid = in_child(begin_two)
    with limits.under_way("192.0.2.1", "call"):
        with pytest.raises(RateLimitedError) as caught, limits.under_way("192.0.2.1", "call"):
            pass
        assert caught.value.facts["limit_at_once"] == 3
        with limits.under_way("192.0.2.2", "call"):
            assert limits.active.total() == 4
        end(pid)
        limits.active.clear(1)
        with limits.under_way("192.0.2.1", "call"), limits.under_way("192.0.2.1", "call"):
            assert limits.active.total() == 3
    assert limits.active.total() == 0


def test_process_has_no_more_slots_than_its_own():
    counts = ActiveCounts(2, processes=2)
    slots = [counts.add("a", None) for _ in range(2)]
    with pytest.raises(IndexError):
        counts.add("b", None)
    for slot in slots:
        counts.remove(slot)
    assert counts.add("b", 1) is not None
    assert counts.add("b", 1) is None


def test_flood_of_keys_forgets_the_oldest_and_keeps_the_newest_and_those_that_are_written_again():
    table = KeyTable()
    for number in range(3 * MAX_KEYS):
        table.put(str(number), float(number), float(number))
    assert table.get("0") is None
    newest = range(3 * MAX_KEYS - MAX_KEYS // 4, 3 * MAX_KEYS)
    kept = [number for number in newest if table.get(str(number)) == (float(number), float(number))]
    assert len(kept) > 0.99 * len(newest)  # a set of 16 gets 4 of them on average; the chance of 17 is 1e-6
    table = KeyTable()
    for number in range(3 * MAX_KEYS):
        table.put(str(number), 0.0, float(number))
        if number % 100 == 0:
            table.put("kept", 1.0, float(number))
    value, _ = table.get("kept")
    assert value == 1.0
