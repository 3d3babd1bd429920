"""The real program with a handle for faults: `python -m tests.e2e.faults.launch FOLDER COMMAND... --parent PID`.

FOLDER/slow holds the seconds that each fsync takes, FOLDER/full makes fsync say that the disk is full (where no small
file system could be mounted). Pictures that carry a note are estimated as it says (stub_tasks.py), all others by the
real pipeline. FAULT_VERSION and FAULT_PROTOCOL make it an older release. Orphans go after seconds, not after a day, so
that the store is listed for them in the midst of uploads that are slow, break off and come again.
"""

import contextlib
import dataclasses
import errno
import functools
import os
import pathlib
import sys
import time
from datetime import timedelta

import app
from app.core.process_life import die_with_parent

STUB_TASKS = "tests.e2e.faults.stub_tasks:TASKS"
ORPHAN_GRACE = timedelta(seconds=1)
ORPHAN_ROUND_SECONDS = 2.0
WAIT_FOR_ROOM_SECONDS = 1.0  # and four, before an estimate whose child was killed is tried again


def main(folder, *command, parent):
    die_with_parent(parent)
    if "FAULT_VERSION" in os.environ:
        app.__version__ = os.environ["FAULT_VERSION"]  # before whoever takes it from there
    from app import worker
    from app.cli import serving
    from app.cli.main import main as tada
    from app.jobs import queue
    from app.meals.estimate import job_worker

    for module in (queue, job_worker):
        module.JOB_PROTOCOL_VERSION = int(os.environ.get("FAULT_PROTOCOL", queue.JOB_PROTOCOL_VERSION))
    worker.TASKS = STUB_TASKS
    delete_orphans_soon()
    job_worker.WorkerTimes = functools.partial(job_worker.WorkerTimes, wait_for_room=WAIT_FOR_ROOM_SECONDS)
    own = [sys.executable, "-m", "tests.e2e.faults.launch", folder, "worker"]
    serving.WorkerProcess = functools.partial(serving.WorkerProcess, command=own)
    os.fsync = faulty_fsync(os.fsync, pathlib.Path(folder))
    sys.argv = ["tada", *command]
    tada()


def delete_orphans_soon():
    from app import worker
    from app.privacy import delete_blobs
    from app.privacy.delete_blobs import BlobDeleter

    BlobDeleter.orphan_batches = functools.partialmethod(BlobDeleter.orphan_batches, ORPHAN_GRACE)
    delete_blobs.FILES = delete_blobs.BUCKET = delete_blobs.Pace(
        interval=timedelta(seconds=ORPHAN_ROUND_SECONDS), first_after=timedelta(0)
    )
    worker_chores = worker.worker_chores

    def chores(*arguments):
        return [
            dataclasses.replace(chore, every_seconds=ORPHAN_ROUND_SECONDS) if chore.name == "delete_orphans" else chore
            for chore in worker_chores(*arguments)
        ]

    worker.worker_chores = chores


def faulty_fsync(fsync, folder):
    def slow_or_full(file):
        if (folder / "full").exists():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        with contextlib.suppress(FileNotFoundError, ValueError):  # not there, or being written
            time.sleep(float((folder / "slow").read_text()))
        fsync(file)

    return slow_or_full


if __name__ == "__main__":
    *arguments, flag, parent_pid = sys.argv[1:]
    assert flag == "--parent"
    main(*arguments, parent=int(parent_pid))
