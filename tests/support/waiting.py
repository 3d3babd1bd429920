"""Waiting in tests for what happens in another thread or process: never a fixed time."""

import contextlib
import sys
import threading
import time
from itertools import pairwise

import sqlalchemy as sa

from app.db.session import Database

PATIENCE_SECONDS = 60.0  # of a loaded machine; no test takes nearly so long otherwise
_BLOCKED_CALLS = sa.text(
    "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock'"
)


def wait_until(condition, awaited, *, interval_seconds=0.03, patience_seconds=PATIENCE_SECONDS):
    """Poll until the condition is truthy and return its value; fail after a long time, naming what was awaited.

    awaited: words, or a function that returns them at the failure, such as a log.
    """
    deadline = time.monotonic() + patience_seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited in vain for {awaited() if callable(awaited) else awaited}"
        time.sleep(interval_seconds)
    return value


def wait_for_blocked_transaction(database):
    """Wait until another transaction waits for a lock that this thread's transaction holds.

    SQLite has no locks of rows: there the other's thread stands where it waits for its turn to write.
    """

    def is_blocked():
        if database.is_sqlite:
            waits = Database._write_lock.__wrapped__.__code__
            return any(frame.f_code is waits for frame in sys._current_frames().values())
        with database.read() as session:
            return session.scalar(_BLOCKED_CALLS)

    wait_until(is_blocked, "a transaction that waits for a lock")


def unless_held_up(attempt, seconds):
    """Call attempt() again if it fails while this process was held up; a failure without that is raised at once.

    seconds: held up is longer than this. However long the attempt waits for others does not count.
    """
    for _ in range(20):
        try:
            with ticking(seconds / 10) as ticks:
                return attempt()
        except (AssertionError, ConnectionError):
            if max(later - former for former, later in pairwise(ticks)) < seconds:
                raise
    raise AssertionError("this machine held up every attempt")


@contextlib.contextmanager
def ticking(interval_seconds):
    """Yield a list to which a thread appends the time, s, again and again: a longer gap is a stall of this process."""
    ticks, ending = [time.monotonic()], threading.Event()

    def tick():
        while not ending.wait(interval_seconds):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick, name="ticks")
    thread.start()
    try:
        yield ticks
    finally:
        ending.set()
        thread.join()
        ticks.append(time.monotonic())
