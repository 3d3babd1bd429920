"""The folder of one run of the tests, and the end of all that the run started, however it ends.

The run's temporary files lie in the folder, and its path is in the environment (TMPDIR) or the command line of each
process that tests start. A helper process waits for the end of the run, also by SIGKILL: then it ends what is left of
these processes and deletes the folder.
"""

import contextlib
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

MEMORY = pathlib.Path("/dev/shm")
MEMORY_BYTES = 2**33  # more than a whole run and its processes take: a passed test's files are deleted at once
PREFIX = "tada-tests-"
GRACE_SECONDS = 5.0  # PostgreSQL removes its shared memory when it is asked to end, not when it is killed
POLL_SECONDS = 0.05


class RunFolder:
    """Made in memory where there is room: a sync to disk takes milliseconds, and the files need not last."""

    def __init__(self):
        place = MEMORY if "TMPDIR" not in os.environ and _has_room(MEMORY) else None
        self.path = tempfile.mkdtemp(prefix=PREFIX, dir=place)
        pathlib.Path(self.path).chmod(0o755)  # PostgreSQL runs as a user of its own
        os.environ["TMPDIR"] = tempfile.tempdir = self.path
        self._cleaner = subprocess.Popen(
            [sys.executable, __file__, self.path], stdin=subprocess.PIPE, start_new_session=True
        )

    def close(self):
        """Return when nothing is left."""
        self._cleaner.stdin.close()
        self._cleaner.wait()


def _has_room(folder):
    if not os.access(folder, os.W_OK) or os.statvfs(folder).f_flag & os.ST_NOEXEC:
        return False
    available = re.search(r"^MemAvailable: +(\d+) kB", pathlib.Path("/proc/meminfo").read_text(), re.MULTILINE)
    is_free = available is not None and int(available[1]) * 1024 > MEMORY_BYTES
    return is_free and shutil.disk_usage(folder).free > MEMORY_BYTES / 2


def processes_of(folder):
    """Return the process ids of all that name the folder, but this one."""
    found = []
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            texts = (process / "environ").read_bytes() + (process / "cmdline").read_bytes()
            if folder.encode() in texts and int(process.name) != os.getpid():
                found.append(int(process.name))
    return found


def clean(folder):
    """End the processes that name the folder, and delete it."""
    started = time.monotonic()
    asked = set()
    while processes := processes_of(folder):
        is_late = time.monotonic() > started + GRACE_SECONDS
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                if is_late:
                    os.kill(process, signal.SIGKILL)
                elif process not in asked:
                    os.kill(process, signal.SIGCONT)
                    os.kill(process, signal.SIGINT)
        asked.update(processes)
        time.sleep(POLL_SECONDS)
    shutil.rmtree(folder, ignore_errors=True)
    for path in MEMORY.glob("*faketime_s*_[0-9]*"):  # libfaketime's, named after a process that was killed
        if not pathlib.Path("/proc", path.name.rpartition("_")[2]).exists():
            path.unlink(missing_ok=True)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sys.stdin.buffer.read()  # ends with the run
    clean(sys.argv[1])
