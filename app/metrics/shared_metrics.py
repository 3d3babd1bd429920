"""Metrics of several processes of one server, added up: prometheus_client's multiprocess mode.

Each process counts in files of its own, in a folder that the environment names; whichever is asked
for /metrics reads them all. Counters of processes that have ended still count, so a sum never
falls.
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
    """Let this program and the processes that it starts count together, in a folder that is removed when it ends.

    Raises RuntimeError if prometheus_client was imported before: it looks at the environment only
    then.
    """
    if "prometheus_client" in sys.modules:
        raise RuntimeError("prometheus_client is imported already and counts for one process only.")
    folder = tempfile.mkdtemp(prefix="tada-metrics-")
    os.environ[VARIABLE] = folder
    atexit.register(shutil.rmtree, folder, ignore_errors=True)


def shared_folder() -> Path | None:
    """Return the folder; None if this process counts for itself."""
    return Path(os.environ[VARIABLE]) if VARIABLE in os.environ else None


def process_ids() -> Iterator[str]:
    """Yield the ids of the server's processes: those that have counted and live, and their parent.

    What a process that has ended had under way is forgotten; its counters stay.
    """
    parent = os.getppid()
    folder = shared_folder()
    files = list(folder.glob("*.db")) if folder is not None else []
    counted = {file.stem.rpartition("_")[2] for file in files}
    living = {pid for pid in counted | {str(parent)} if _is_of(pid, str(parent))}
    for file in files:
        if file.name.startswith("gauge_live") and file.stem.rpartition("_")[2] not in living:
            file.unlink(missing_ok=True)
    yield from sorted(living)


def _is_of(pid: str, parent: str) -> bool:
    """Whether a process is the parent or a living child of it, and not a stranger with a reused id."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return False
    return parent in (pid, fields[1])
