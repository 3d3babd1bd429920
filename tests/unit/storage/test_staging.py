"""Files in the making: what a dead process left goes, what a living process writes stays, whatever the clock says."""

import signal
import subprocess
import sys
import time

import pytest

from app.storage import blob_store
from app.storage.blob_store import LOCK_SUFFIX, Staging

LONG_AGO = 400 * 24 * 3600.0
OTHER_PROCESS = """
import sys, pathlib, time
from app.storage.blob_store import Staging
mine = Staging(pathlib.Path(sys.argv[1]))
(mine.folder / "photograph").write_bytes(b"x")
(mine.folder / "estimate").mkdir()
print(mine.folder, flush=True)
if sys.argv[2] == "stay":
    time.sleep(60)
"""


@pytest.fixture
def other_process():
    """Starts a process that stages a file and stays or ends; returns it with its folder."""
    processes = []

    def start(parent, what):
        process = subprocess.Popen(
            [sys.executable, "-c", OTHER_PROCESS, str(parent), what], stdout=subprocess.PIPE, text=True
        )
        processes.append(process)
        return process, blob_store.Path(process.stdout.readline().strip())

    yield start
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def everything_in(parent):
    return sorted(path.name for path in parent.iterdir())


def test_what_a_living_process_writes_stays_whatever_our_clock_says_and_goes_once_it_is_killed(
    tmp_path, other_process, monkeypatch
):
    process, theirs = other_process(tmp_path, "stay")
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + LONG_AGO)
    ours = Staging(tmp_path)
    ours.remove_abandoned()
    assert (theirs / "photograph").read_bytes() == b"x"
    assert ours.folder.is_dir()
    process.send_signal(signal.SIGKILL)
    process.wait()
    ours = Staging(tmp_path)
    assert everything_in(tmp_path) == [ours.folder.name, ours.folder.name + LOCK_SUFFIX]


def test_process_that_ends_well_and_a_store_that_is_given_up_leave_nothing(tmp_path, other_process):
    process, _ = other_process(tmp_path, "end")
    process.wait()
    ours = Staging(tmp_path)
    (ours.folder / "photograph").write_bytes(b"x")
    del ours
    assert everything_in(tmp_path) == []


def test_lock_that_was_removed_before_it_was_held_is_not_used(tmp_path, monkeypatch):
    """Another process may look at the file in the moment between its making and its lock."""
    flock, removed = blob_store.fcntl.flock, []

    def removed_first(handle, operation):
        if not removed:
            removed.extend(tmp_path.glob("*" + LOCK_SUFFIX))
            removed[0].unlink()
        return flock(handle, operation)

    monkeypatch.setattr(blob_store.fcntl, "flock", removed_first)
    ours = Staging(tmp_path)
    assert removed[0].name not in everything_in(tmp_path)
    assert ours.folder.with_name(ours.folder.name + LOCK_SUFFIX).exists()
