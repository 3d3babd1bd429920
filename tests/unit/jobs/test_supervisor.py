import contextlib
import os
import pathlib
import signal
import subprocess
import sys

import pytest

from app.core.settings import Settings
from app.jobs.supervisor import WorkerProcess
from tests.support.waiting import wait_until

ROOT = pathlib.Path(__file__).parents[3]
WRITE_PID_AND_WAIT = "import os, pathlib, sys, time; pathlib.Path('pid').write_text(str(os.getpid())); time.sleep(600)"


def wait_for_pid(folder, other_than=None):
    def written():
        with contextlib.suppress(FileNotFoundError, ValueError):
            pid = int((folder / "pid").read_text())
            return pid != other_than and pid

    return wait_until(written, "a process that writes its id")


def has_ended(pid):
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_killed_worker_is_started_again_and_stop_ends_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    worker = WorkerProcess(Settings(data_dir=tmp_path), [sys.executable, "-c", WRITE_PID_AND_WAIT])
    worker.start()
    first = wait_for_pid(tmp_path)
    os.kill(first, signal.SIGKILL)
    second = wait_for_pid(tmp_path, other_than=first)
    wait_until(lambda: worker.pid == second, "the supervisor to have the new process")
    worker.stop()
    assert has_ended(second)
    assert worker.pid is None


@pytest.mark.slow
def test_worker_beside_the_server_gives_way_to_it():
    """One on its own does not: its machine is there for it."""
    script = "import os, sys, app.worker; app.worker.run_worker = lambda _: print(os.nice(0)) or 0; app.worker.main()"
    here = os.nice(0)
    for arguments, expected in ((["--parent", str(os.getpid())], here + 5), ([], here)):
        command = [sys.executable, "-c", script, *arguments]
        ended = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
        assert int(ended.stdout) == min(expected, 19)
