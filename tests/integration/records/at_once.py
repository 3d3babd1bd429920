"""Calls that begin at the same time."""

import threading
from concurrent.futures import ThreadPoolExecutor


def at_once(*calls):
    """Make each call in a thread of its own, all at the same time; returns their results in the order of the calls."""
    start = threading.Barrier(len(calls))

    def begin(call):
        start.wait()
        return call()

    with ThreadPoolExecutor(len(calls)) as threads:
        return list(threads.map(begin, calls))
