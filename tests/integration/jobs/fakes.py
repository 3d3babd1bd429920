"""Use cases with a visible effect, and a worker process that runs them: `python -m tests.integration.jobs.fakes`.

What a job does stands in its meal's details["fake"]. Each save writes a row into the table fake_save, which has no key:
a second save of a job would be seen.
"""

import argparse
import errno
import os
import time
import uuid
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa

import app.tables  # noqa: F401  # defines every table
from app.children.child_pool import ChildRequest
from app.children.faults import BrokenOff, JobFailure
from app.core.process_life import die_with_parent
from app.core.settings import Settings
from app.jobs.chores import Chore
from app.jobs.queries import WorkerTimes
from app.meals.estimate.job_worker import run_jobs
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.people.models import Device, Participant, Study
from tests.support.waiting import wait_until

TIMES = WorkerTimes(heartbeat=0.25, lease=2.0, first_wait=0.05, longest_wait=0.2, wait_for_room=0.1, drain=1.0)
LONG_LEASE = 60.0  # where nobody dies: a worker that a loaded machine holds up keeps its jobs
LONG_DRAIN = 8.0  # a worker ends after ten seconds in any case
LEAVE_SECONDS = 0.3  # longer than a worker without jobs takes to end
FAKE_TASKS = "tests.unit.children.fake_tasks:TASKS"


class FakeUseCases:
    def __init__(self, database, pool, folder):
        self._database = database
        self._pool = pool
        self._folder = folder

    def compute(self, job_id, *, is_alone):
        with self._database.read() as session:
            meal = session.get_one(Meal, session.get_one(Job, job_id).meal_id)
            what = meal.details["fake"]
        (self._folder / f"computing-{job_id}-{os.getpid()}").touch()
        if what == "hold":
            self._wait_for(f"go-{job_id}")
        elif what == "bug":
            raise KeyError("a bug")
        elif what == "full_disk" and not (self._folder / f"go-{job_id}").exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        elif what.startswith("child:"):
            result = self._pool.run(
                ChildRequest(what.removeprefix("child:"), {"folder": str(self._folder), "job": str(job_id)}),
                lambda _: None,
                name=str(job_id),
                is_alone=is_alone,
            )
            if result.is_passing:
                raise BrokenOff(result.failure)
            if result.failure is not None:
                raise JobFailure(result.failure)
        return f"results/{job_id}"

    def load(self, result_key):
        job_id = result_key.removeprefix("results/")
        with self._database.read() as session:
            what = session.get_one(Meal, session.get_one(Job, uuid.UUID(job_id)).meal_id).details["fake"]
        if what == "hold_in_load":
            (self._folder / f"loading-{job_id}-{os.getpid()}").touch()
            self._wait_for(f"go-{job_id}")
        return {"key": result_key}

    def save(self, session, job_id, result):
        meal = session.get_one(Meal, session.get_one(Job, job_id).meal_id)
        what = meal.details["fake"]
        session.execute(
            sa.text("INSERT INTO fake_save (job_id, pid) VALUES (:job, :pid)"), {"job": str(job_id), "pid": os.getpid()}
        )
        if what == "bug_in_save":
            raise KeyError("a bug that quotes a secret")
        if what == "hold_in_save":
            (self._folder / f"saving-{job_id}-{os.getpid()}").touch()
            self._wait_for(f"go-{job_id}")
        if what == "full_disk_in_save" and not (self._folder / f"go-{job_id}").exists():
            (self._folder / f"saving-{job_id}-{os.getpid()}").touch()
            raise OSError(errno.ENOSPC, "No space left on device")
        assert result == {"key": f"results/{job_id}"}
        meal.status = "estimated"
        meal.version += 1

    def await_room(self, job_id):
        (self._folder / f"waits-{job_id}-{time.monotonic_ns()}").touch()

    def abandon(self, job_id):
        if self._pool.cancel(str(job_id)):
            (self._folder / f"abandoned-{job_id}").touch()

    def settle(self, session, meal):
        meal.details = meal.details | {"settled": True}

    def _wait_for(self, name):
        wait_until((self._folder / name).exists, name)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--parent", type=int, required=True)
    parser.add_argument("--protocol", type=int)
    parser.add_argument("--lease", type=float)
    parser.add_argument("--drain", type=float)
    arguments = parser.parse_args()
    die_with_parent(arguments.parent)

    def make_use_cases(database, pool):
        return FakeUseCases(database, pool, arguments.folder)

    def make_chores(_database, _pool):
        return [Chore("take leave", 3600.0, lambda: None, at_end=take_leave)]

    def take_leave():
        time.sleep(LEAVE_SECONDS)
        (arguments.folder / f"left-{os.getpid()}").touch()

    times = replace(TIMES, lease=arguments.lease, drain=arguments.drain)
    settings, protocol = Settings(), arguments.protocol
    raise SystemExit(
        run_jobs(settings, make_use_cases, tasks=FAKE_TASKS, make_chores=make_chores, times=times, protocol=protocol)
    )


def new_job(session, queue, fake="quick", device_id=None):
    """A meal with its job, queued in the session's transaction; returns the job's id. device_id: whose meal it is."""
    job, _ = new_unqueued_job(session, fake, device_id)
    queue.enqueue(session, job)
    return job.id


def new_unqueued_job(session, fake="quick", device_id=None):
    """A meal and its job that has no turn yet."""
    meal = new_meal(session, fake, device_id)
    job = Job(id=uuid.uuid4(), meal_id=meal.id, state="queued", attempts=0, enqueued_at=meal.received_at)
    session.add(job)
    session.flush()
    return job, meal


def new_device(session):
    """The phone of the one participant of a new study."""
    now = datetime.now(UTC)
    study = Study(id=uuid.uuid4(), code=uuid.uuid4().hex, name="s", created_at=now)
    session.add(study)
    session.flush()
    participant = Participant(id=uuid.uuid4(), study_id=study.id, code="p", created_at=now)
    session.add(participant)
    session.flush()
    device = Device(id=uuid.uuid4(), participant_id=participant.id, name="d", enrolled_at=now)
    session.add(device)
    session.flush()
    return device


def new_meal(session, fake="quick", device_id=None):
    now = datetime.now(UTC)
    device = session.get_one(Device, device_id) if device_id is not None else new_device(session)
    participant = session.get_one(Participant, device.participant_id)
    meal = Meal(
        id=uuid.uuid4(),
        client_id=uuid.uuid4(),
        study_id=participant.study_id,
        participant_id=participant.id,
        device_id=device.id,
        captured_at=now,
        utc_offset_minutes=0,
        time_zone="UTC",
        local_date=now.date(),
        details={"fake": fake},
        status="queued",
        received_at=now,
        submitted_at=now,
    )
    session.add(meal)
    session.flush()
    return meal


if __name__ == "__main__":
    main()
