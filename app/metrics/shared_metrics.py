"""Metrics of several processes of one server, added up: prometheus_client's multiprocess mode.

Each process counts in files of its own, in a folder that the environment names; whichever is asked for /metrics reads
them all. Counters of processes that have ended still count, so a sum never falls.
"""

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

VARIABLE = "PROMETHEUS_MULTIPROC_DIR"


def share_metrics() -> None:
    """Let this program and the processes that it forks count together, in a folder that is removed when it ends.

    Raises RuntimeError if prometheus_client was imported before: it looks at the environment only then.
    """
    if "prometheus_client" in sys.modules:
        raise RuntimeError("prometheus_client is imported already and counts for one process only.")
    folder = tempfile.mkdtemp(prefix="tada-metrics-")
    os.environ[VARIABLE] = folder
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # and not a forked process
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)


def shared_folder() -> Path | None:
    """Return the folder; None if this process counts for itself."""
    return Path(os.environ[VARIABLE]) if VARIABLE in os.environ else None


def forget_process(pid: int) -> None:
    """Forget what a process that has ended had under way; its counters stay."""
    folder = shared_folder()
    for file in folder.glob(f"gauge_live*_{pid}.db") if folder is not None else ():
        file.unlink()


def process_ids() -> Iterator[str]:
    """Yield the ids of the server's processes: those that have counted and live, and their parent."""
    parent = os.getppid()
    folder = shared_folder()
    counted = {file.stem.rpartition("_")[2] for file in folder.glob("counter_*.db")} if folder is not None else set()
    for pid in sorted(counted | {str(parent)}):
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if pid == str(parent) or fields[1] == str(parent):  # the second: its parent's id; not a stranger's reused one
            yield pid
