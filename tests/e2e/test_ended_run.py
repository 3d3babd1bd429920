"""A run of the tests that is ended leaves no process and no file behind."""

import os
import pathlib
import re
import signal
import subprocess
import sys

import pytest

from tests.support.run_folder import MEMORY, processes_of
from tests.support.waiting import PATIENCE_SECONDS, wait_until

REPOSITORY = pathlib.Path(__file__).parents[2]

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def heard_interrupt():
    """Tests that run in a shell's background ignore SIGINT, and so would the run that they start."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def shared_memory(folder):
    """Return the files in memory that processes of the run have mapped, such as PostgreSQL's."""
    maps = "".join(pathlib.Path(f"/proc/{process}/maps").read_text() for process in processes_of(folder))
    return set(re.findall(rf"{MEMORY}/PostgreSQL\.\d+", maps))


@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, 0), (signal.SIGTERM, 1), (signal.SIGKILL, 1)])
def test_ended_run_leaves_no_process_and_no_file(tmp_path, number, workers):
    ready = tmp_path / "ready"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    with subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", f"-n{workers}", "-p", "no:cacheprovider", "tests/e2e/held_run.py"],
        cwd=REPOSITORY,
        env=environment | {"HELD_RUN_IS_READY": str(ready)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as run:
        try:
            wait_until(
                lambda: ready.exists() or run.poll() is not None, "the run to hold everything", patience_seconds=600
            )
            folder = ready.read_text()
            mapped = shared_memory(folder)
            assert len(processes_of(folder)) > 5  # PostgreSQL, S3, Chromium, the server and its worker
            assert mapped
        finally:
            run.send_signal(number)
            try:
                run.wait(PATIENCE_SECONDS)
            finally:
                run.kill()  # which does nothing where it has ended

    wait_until(lambda: not pathlib.Path(folder).exists(), "the run's folder to be deleted")
    wait_until(lambda: not processes_of(folder), "the last process, which deleted it, to end")
    assert [name for name in mapped if pathlib.Path(name).exists()] == []
