"""A database ready for jobs, and real worker processes over it that are gone after the test."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys

import pytest
import sqlalchemy as sa

from app.core.settings import Settings
from app.db.session import Database
from app.jobs.leases import living_workers
from app.jobs.queue import JobQueue
from app.jobs.supervisor import settings_environment
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from tests.integration.jobs.fakes import TIMES, new_device, new_job
from tests.support.waiting import wait_until

ROOT = pathlib.Path(__file__).parents[3]


class Jobs:
    """One database with its queue and workers, and what a test asks of them."""

    def __init__(self, database, folder):
        self.database = database
        self.folder = folder
        self.queue = JobQueue()
        self.settings = Settings(
            database_url=database.url,
            data_dir=folder / "data",
            estimate_seconds=1.0,
            log_format="console",
            worker_concurrency=1,
        )
        self.workers = []

    def start_worker(self, *, protocol=None, lease=TIMES.lease, drain=TIMES.drain, **changes):
        """A worker that lives. lease, drain: its times, in seconds."""
        settings = self.settings.model_copy(update=changes)
        environment = {name: value for name, value in os.environ.items() if not name.startswith("TADA_")}
        environment |= settings_environment(settings) | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "tests.integration.jobs.fakes", "--parent", str(os.getpid())]
        command += ["--protocol", str(protocol)] if protocol is not None else []
        command += ["--lease", str(lease), "--drain", str(drain)]
        worker = subprocess.Popen([*command, "--folder", str(self.folder)], env=environment, cwd=self.folder)
        self.workers.append(worker)
        wait_until(
            lambda: worker.poll() is not None or any(w.pid == worker.pid for w in self.living()), "a worker to live"
        )
        assert worker.poll() is None, "the worker ended at once"
        return worker

    def living(self):
        return living_workers(self.database, TIMES)

    def add(self, fake="quick", device_id=None):
        with self.database.write() as session:
            return new_job(session, self.queue, fake, device_id)

    def new_study(self):
        """A study of one phone: the phone's id."""
        with self.database.write() as session:
            return new_device(session).id

    def go(self, job_id):
        (self.folder / f"go-{job_id}").touch()

    def wait_for_file(self, pattern):
        return wait_until(lambda: sorted(self.folder.glob(pattern)), f"a file {pattern}")[0]

    def job(self, job_id):
        with self.database.read() as session:
            return session.get(Job, job_id)

    def meal(self, job_id):
        with self.database.read() as session:
            return session.get_one(Meal, session.get_one(Job, job_id).meal_id)

    def wait_for_state(self, job_id, state):
        wait_until(lambda: self.job(job_id).state == state, f"the job to be {state}")

    def saves(self, job_id):
        """Process ids of those who saved."""
        with self.database.read() as session:
            return list(session.scalars(sa.text("SELECT pid FROM fake_save WHERE job_id = :job"), {"job": str(job_id)}))

    def change(self, job_id, **values):
        """Set columns of a job's row."""
        with self.database.write() as session:
            session.execute(sa.update(Job).where(Job.id == job_id).values(values))

    def run_sql(self, text):
        """The first value of a statement's first row, or None."""
        with self.database.write() as session:
            result = session.execute(sa.text(text))
            return result.scalar() if result.returns_rows else None

    def close(self):
        for worker in self.workers:
            with contextlib.suppress(ProcessLookupError):
                worker.send_signal(signal.SIGCONT)
                worker.kill()
            worker.wait()


@pytest.fixture
def jobs(prepared_database_url, tmp_path):
    database = Database(prepared_database_url)
    found = Jobs(database, tmp_path)
    found.run_sql("CREATE TABLE fake_save (job_id TEXT, pid INTEGER)")
    yield found
    found.close()
    database.dispose()
