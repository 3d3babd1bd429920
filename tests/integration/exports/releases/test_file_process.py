"""The worker's thread for exports and releases, and its process: killed, stopped, left behind."""

import os
import signal
import sys

import pytest
import sqlalchemy as sa

from app.exports import file_task
from app.exports.models import Export
from app.exports.releases.file_work_chore import FileThread
from app.people.access.secret_box import SecretBox
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.people.people import make_staff
from tests.support.stores import stored_names
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow
PROGRAM = """
import os, sys, time
sys.stdin.read()
with open(os.environ["TADA_TEST_PID"], "w") as file:
    file.write(str(os.getpid()))
time.sleep(600)
"""
ASLEEP = (sys.executable, "-c", PROGRAM)


@pytest.fixture
def asked(client, admin, enrol, state):
    """A viewer's export that waits: how to look at it."""
    enrol("P001")
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple"))
    viewer = make_staff(client, admin, "vera", pilot="viewer")
    path = viewer.post("/v1/studies/pilot/exports", json={"rows": "items", "format": "parquet"}).headers["location"]
    return lambda: viewer.get(path).json()


@pytest.fixture
def files(state):
    threads = []

    def start():
        threads.append(FileThread(state.database, state.blobs, state.settings, state.part(SecretBox)))
        return threads[-1]

    yield start
    for thread in threads:
        thread.stop()


@pytest.fixture
def asleep(monkeypatch, tmp_path):
    """Processes that write nothing and do not end: the id of the newest."""
    path = tmp_path / "pid"
    monkeypatch.setenv("TADA_TEST_PID", str(path))
    monkeypatch.setattr(file_task, "COMMAND", ASLEEP)

    def pid():
        wait_until(lambda: path.exists() and path.read_text(), "the process")
        return int(path.read_text())

    return pid


def attempts(state):
    with state.database.read() as session:
        return session.scalar(sa.select(Export.attempts))


def test_thread_makes_the_file(asked, files):
    thread = files()
    wait_until(lambda: thread.look() or asked()["state"] == "done", "the file")
    assert asked()["rows_written"] == 1


def test_work_of_a_killed_process_begins_again(state, asked, files, asleep, monkeypatch):
    files().look()
    os.kill(asleep(), signal.SIGKILL)
    wait_until(lambda: asked()["state"] == "queued", "the work to be given back")
    monkeypatch.undo()
    with state.database.write() as session:
        session.execute(sa.update(Export).values(begin_after=None))
    other = files()
    wait_until(lambda: other.look() or asked()["state"] == "done", "the file")
    assert attempts(state) >= 2


def test_stopped_worker_releases_its_work_without_counting_an_attempt(state, asked, files, asleep):
    thread = files()
    thread.look()
    pid = asleep()
    thread.stop()
    assert asked()["state"] == "queued"
    assert attempts(state) == 0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not [name for name in stored_names(state.blobs) if "made-" in name]
