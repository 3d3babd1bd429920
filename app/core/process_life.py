"""How a process begins and ends.

It keeps its files private, and ends with its parent, however the parent ends (`die_with_parent`),
or in order, by a signal.
"""

import asyncio
import contextlib
import ctypes
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

PR_SET_PDEATHSIG = 1  # linux/prctl.h
# a batch of an export has fewer; Python's 700 cost an export a tenth of its time
OBJECTS_PER_COLLECTION = 50_000
OTHERS = 0o077  # permissions of group and others


def die_with_parent(parent_pid: int) -> None:
    """Ask the kernel for SIGKILL when the parent dies, and exit now if it is already dead.

    Linux only; elsewhere a child notices the end of its standard input. The kernel watches the
    parent's thread that started this process, so a parent must start children from a thread that
    outlives them.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:  # it died between the fork and the call above
        os._exit(0)


@contextlib.contextmanager
def at_stop_signal(call: Callable[[], object]) -> Iterator[None]:
    """Call in this event loop at SIGTERM or SIGINT, before the server's own handler waits for all requests.

    Does nothing outside the main thread, where no signal is handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    loop = asyncio.get_running_loop()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def on_signal(number: int, frame: FrameType | None) -> None:
        loop.call_soon_threadsafe(call)
        handler = handlers[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)

    for number in handlers:
        signal.signal(number, on_signal)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def collect_rarely() -> None:
    """Take all objects loaded by now as permanent, and search the newer ones less often.

    What has no cycle, as rows have none, is freed at once anyway. Collecting the permanent ones
    repeatedly would delay requests by 0.1 s.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(OBJECTS_PER_COLLECTION)


def keep_files_private() -> None:
    """Create files as 0600 and folders as 0700, whatever umask the process inherited."""
    os.umask(OTHERS)
