"""Each test is a program of its own: a test runner's process may have threads, and is not forked then."""

import json
import subprocess
import sys
from textwrap import dedent

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks are used on Linux alone")

BEGIN = """
import json, os, resource, signal, sys, threading, time
from app.core.side_by_side import beside, mapped
HERE = os.getpid()

def has_children():
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return False
    return True
"""


def result_of(program):
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + dedent(program)], capture_output=True, text=True, check=True, timeout=120
    )
    return json.loads(done.stdout)


def test_results_are_in_the_order_of_the_items_whichever_process_made_them():
    results, has_left_any = result_of("""
        def work(item):
            time.sleep(0.05 if item else 0.5)  # the first item takes one process as long as all others
            return item, os.getpid() == HERE

        print(json.dumps([mapped(work, range(8), 3), has_children()]))
    """)
    assert [item for item, _ in results] == list(range(8))
    assert {is_here for _, is_here in results} == {True, False}
    assert not has_left_any


def test_exception_of_an_item_passes_through():
    assert result_of("""
        def work(item):
            if item == 3:
                raise ValueError("item 3")
            return item

        told = []
        for cores in (1, 2, 3):
            try:
                mapped(work, range(6), cores)
            except ValueError as error:
                told.append([str(error), has_children()])
        print(json.dumps(told))
    """) == [["item 3", False]] * 3  # fmt: skip


@pytest.mark.parametrize("end", ["os.kill(os.getpid(), signal.SIGKILL)", "os._exit(3)", "raise MemoryError"])
def test_what_a_process_that_ends_does_not_answer_is_done_here(end):
    results, result, has_left_any = result_of(f"""
        def work(item):
            time.sleep(0.05)
            if os.getpid() != HERE:
                {end}
            return item

        results = mapped(work, range(6), 2)
        with beside(lambda: work("beside"), 2) as other:
            result = other()
        print(json.dumps([results, result, has_children()]))
    """)
    assert results == list(range(6))
    assert result == "beside"
    assert not has_left_any


def test_what_cannot_be_sent_is_done_here_and_work_that_nobody_asks_for_is_ended_or_not_begun_on_one_core():
    assert result_of("""
        with beside(lambda: (lambda: 7), 2) as other:
            told = [other()()]
        with beside(lambda: time.sleep(3600), 2):
            told.append(has_children())
        told.append(has_children())
        with beside(lambda: told.append("begun"), 1):
            pass
        print(json.dumps(told))
    """) == [7, True, False]  # fmt: skip


def test_process_with_another_thread_or_whose_children_the_kernel_reaps_is_not_forked():
    """As of a program that was started where SIGCHLD is ignored: it could not wait for them."""
    assert result_of("""
        ending = threading.Event()
        thread = threading.Thread(target=ending.wait)
        thread.start()
        processes = mapped(lambda _: os.getpid(), range(4), 2)
        ending.set()
        thread.join()
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        with beside(os.getpid, 2) as other:
            processes.append(other())
        processes += mapped(lambda _: os.getpid(), range(4), 2)
        print(json.dumps([each == HERE for each in processes]))
    """) == [True] * 9  # fmt: skip


def test_work_is_done_here_where_descriptors_are_short():
    assert result_of("""
        results = []
        for free in (3, 2, 1, 0):
            used = len(os.listdir("/proc/self/fd")) - 1  # less the listing's own
            resource.setrlimit(resource.RLIMIT_NOFILE, (used + free, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
            results.append(mapped(lambda item: 2 * item, range(4), 2))
        print(json.dumps(results))
    """) == [[0, 2, 4, 6]] * 4  # fmt: skip


def test_forked_process_dies_with_its_parent():
    program = """
        with beside(lambda: time.sleep(3600), 2):
            print("begun", flush=True)
            time.sleep(3600)
    """
    parent = subprocess.Popen([sys.executable, "-c", BEGIN + dedent(program)], stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"begun\n"
    parent.kill()
    assert parent.stdout.read() == b""  # it ends when no process holds the other end any more
    parent.wait()
    parent.stdout.close()


def test_work_beside_is_done_in_a_process_that_has_the_processor_time_that_its_parent_has_left():
    size, limits = result_of("""
        resource.setrlimit(resource.RLIMIT_CPU, (100, 200))
        time.process_time = lambda: 39.5
        with beside(lambda: (b"x" * 1_000_000, resource.getrlimit(resource.RLIMIT_CPU)), 2) as other:
            made, limits = other()  # more than a pipe holds
            print(json.dumps([len(made), limits]))
    """)
    assert (size, limits) == (1_000_000, [61, 200])
