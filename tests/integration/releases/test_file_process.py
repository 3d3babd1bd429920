"""The worker's side process for exports and releases: a real process that is killed, stopped and left behind."""

import os
import signal
import sys

import pytest
import sqlalchemy as sa

from app.exports.models import Export
from app.jobs.chores import Chore, ChoreThread
from app.releases.file_work_chore import FileProcess
from tests.integration.diary.eaten_days import add_meal, eaten_item
from tests.integration.people.people import make_staff
from tests.support.stores import stored_names
from tests.support.waiting import PATIENCE_SECONDS, wait_until

pytestmark = pytest.mark.slow
SLOW = """
import sys, time
from app.exports import made_file
from app import file_worker

write = made_file.StagedFile.write
def slow(file, piece):
    write(file, piece)
    time.sleep(60)
made_file.StagedFile.write = slow
file_worker.main()
"""


@pytest.fixture
def asked(client, admin, enrol, state):
    """A viewer's export that waits: how to look at it."""
    enrol("P001")
    add_meal(state, "P001", "2026-11-01", eaten_item(100.0, "apple"))
    viewer = make_staff(client, admin, "vera", pilot="viewer")
    path = viewer.post("/v1/studies/pilot/exports", json={"rows": "items", "format": "parquet"}).headers["location"]
    return lambda: viewer.get(path).json()


def wait_for(is_so, process):
    """Until it is so, looking after the process meanwhile as its chore does."""
    wait_until(lambda: process.look() or is_so(), "the file process")


def attempts(state):
    with state.database.read() as session:
        return session.scalar(sa.select(Export.attempts))


def test_process_makes_the_file_and_ends(state, settings, asked):
    process = FileProcess(state.database, settings)
    wait_for(lambda: asked()["state"] == "done", process)
    wait_for(lambda: process.pid is None, process)
    assert asked()["rows_written"] == 1


@pytest.mark.both_stores
def test_killed_process_is_replaced_at_once(state, settings, asked):
    slow = FileProcess(state.database, settings, command=(sys.executable, "-c", SLOW))
    wait_for(lambda: asked()["state"] == "running" and asked()["bytes"] > 0, slow)
    os.kill(slow.pid, signal.SIGKILL)
    wait_for(lambda: asked()["state"] == "queued", slow)
    slow.stop()
    other = FileProcess(state.database, settings)
    wait_for(lambda: asked()["state"] == "done", other)
    other.stop()
    assert attempts(state) >= 2


def test_stopped_worker_releases_its_work_without_counting_an_attempt(state, settings, asked):
    slow = FileProcess(state.database, settings, command=(sys.executable, "-c", SLOW))
    chores = ChoreThread([Chore("make_files", 0.1, slow.look, at_end=slow.stop)])
    chores.start()
    wait_until(lambda: asked()["state"] == "running", "the export to run")
    pid = slow.pid
    chores.stop(PATIENCE_SECONDS)
    assert asked()["state"] == "queued"
    assert attempts(state) == 0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not [name for name in stored_names(state.blobs) if "made-" in name]
