"""Work on further cores: `with beside(work, cores) as other: ...; other()`, and `mapped(function, items, cores)`.

A forked process does the work and sends its result through a pipe. Results never depend on the number of cores: what
the forked process does not answer, because it raised, died or could not be started, is done here instead. It dies with
this process. Only on Linux, only while this process has no other thread, which might hold a lock at the fork, and not
where SIGCHLD is ignored, since the kernel then gives a process's number away before it is waited for.
"""

import contextlib
import gc
import math
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from typing import NoReturn, TypeVar

from app.core.process_life import die_with_parent

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

MOST_ITEMS = 256  # a byte names an item


@contextlib.contextmanager
def beside(work: Callable[[], ResultT], cores: int) -> Iterator[Callable[[], ResultT]]:
    """Begin work on another core, if there is one; the function yielded returns its result.

    Work whose result is not asked for within the block is ended there, or never begun.
    """
    forked = _fork(work) if cores > 1 and may_fork() else None
    if forked is None:
        yield work
        return
    process, reading = forked

    def answer() -> ResultT:
        try:
            result: ResultT = pickle.load(pipe)  # noqa: S301  # of this program, in a process with the same limits
        except (EOFError, pickle.UnpicklingError):
            return work()
        return result

    try:
        with os.fdopen(reading, "rb") as pipe:
            yield answer
    finally:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)


def mapped(function: Callable[[ItemT], ResultT], items: Sequence[ItemT], cores: int) -> list[ResultT]:
    """[function(item) for item in items], each on whichever core is free. At most MOST_ITEMS items."""
    if cores < 2 or len(items) < 2 or not may_fork():
        return [function(item) for item in items]
    with contextlib.ExitStack() as stack:
        try:
            queue = stack.enter_context(_queue_of(len(items)))
        except OSError:  # no descriptor is free
            return [function(item) for item in items]

        def work() -> dict[int, ResultT]:
            return {place[0]: function(items[place[0]]) for place in iter(lambda: os.read(queue, 1), b"")}

        others = [stack.enter_context(beside(work, cores)) for _ in range(min(cores, len(items)) - 1)]
        done = work()
        for other in others:
            done |= other()
    # A forked process that did not answer has taken its items from the queue.
    return [done[place] if place in done else function(item) for place, item in enumerate(items)]


def may_fork() -> bool:
    """Return whether this process can be forked safely, and waits for its children itself."""
    is_reaping = sys.platform == "linux" and signal.getsignal(signal.SIGCHLD) is not signal.SIG_IGN
    return is_reaping and threading.active_count() == 1


@contextlib.contextmanager
def _queue_of(count: int) -> Iterator[int]:
    """A pipe with the numbers below count, a byte each, from which several processes read."""
    reading, writing = os.pipe()
    try:
        os.write(writing, bytes(range(count)))
        os.close(writing)
        yield reading
    finally:
        os.close(reading)


def _fork(work: Callable[[], object]) -> tuple[int, int] | None:
    """The id of a process that does the work, and the pipe in which it answers; None if there is no room for it."""
    here, seconds_used = os.getpid(), time.process_time()
    try:
        reading, writing = os.pipe()
    except OSError:
        return None
    try:
        process = os.fork()
    except OSError:
        os.close(reading)
        os.close(writing)
        return None
    if process == 0:
        _answer(work, writing, here, seconds_used)
    os.close(writing)
    return process, reading


def _answer(work: Callable[[], object], writing: int, parent: int, seconds_used: float) -> NoReturn:
    """In the forked process, which leaves all that its parent has opened alone."""
    try:
        die_with_parent(parent)
        _limit_processor_time(seconds_used)
        gc.disable()  # it would write to, and so copy, all pages with objects
        result = work()
        with os.fdopen(writing, "wb") as pipe:
            pickle.dump(result, pipe, pickle.HIGHEST_PROTOCOL)
    except Exception:  # noqa: BLE001  # the parent does the work and raises
        traceback.print_exc()
    finally:
        os._exit(0)


def _limit_processor_time(seconds_used: float) -> None:
    """Leave this process as much as its parent has left, which has used so much: the kernel counts from the fork."""
    import resource  # noqa: PLC0415  # Windows has none, and no fork

    limit, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if limit != resource.RLIM_INFINITY:
        resource.setrlimit(resource.RLIMIT_CPU, (max(1, math.ceil(limit - seconds_used)), hard))
