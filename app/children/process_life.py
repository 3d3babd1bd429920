"""A process that dies with its parent, whatever kills the parent: `die_with_parent(pid)`, first thing in a child."""

import contextlib
import ctypes
import os
import signal

PR_SET_PDEATHSIG = 1  # linux/prctl.h


def die_with_parent(parent_pid: int) -> None:
    """Ask the kernel for SIGKILL when the parent dies, and end now if it is dead already.

    Linux only; elsewhere a child notices by the end of its standard input. The kernel means the parent's thread that
    started this process, so a parent starts children from a thread that lives as long as they shall.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:  # it died between the fork and the call above
        os._exit(0)
