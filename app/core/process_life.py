"""Let a process die with its parent, however the parent ends: a child calls `die_with_parent(pid)` first."""

import contextlib
import ctypes
import os
import signal

PR_SET_PDEATHSIG = 1  # linux/prctl.h


def die_with_parent(parent_pid: int) -> None:
    """Ask the kernel for SIGKILL when the parent dies, and exit now if it is already dead.

    Linux only; elsewhere a child notices the end of its standard input. The kernel watches the parent's thread that
    started this process, so a parent must start children from a thread that outlives them.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:  # it died between the fork and the call above
        os._exit(0)
