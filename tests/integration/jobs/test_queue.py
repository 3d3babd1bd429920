import subprocess
import sys

import pytest
import sqlalchemy as sa

from app.db.models import Job
from app.db.schema_state import MigrationBusyError
from app.jobs.engine import MIGRATION_LOCK, prepare_job_tables
from tests.integration.jobs.fakes import new_job


def test_queued_job_is_done_and_saved_once(jobs):
    job_id = jobs.add()
    worker = jobs.start_worker()
    jobs.wait_for_state(job_id, "done")
    job = jobs.job(job_id)
    assert jobs.saves(job_id) == [worker.pid]
    assert jobs.meal(job_id).status == "estimated"
    assert (job.attempts, job.executor_id) == (1, jobs.living()[0].executor_id)
    assert job.enqueued_at <= job.started_at <= job.finished_at


def test_job_queued_twice_runs_once_and_job_of_a_rolled_back_transaction_never(jobs):
    class Stop(Exception):  # noqa: N818
        pass

    with pytest.raises(Stop), jobs.database.write() as session:  # noqa: PT012
        dropped = new_job(session, jobs.queue)
        raise Stop
    twice, last = jobs.add(), jobs.add()
    with jobs.database.write() as session:
        jobs.queue.enqueue(session, session.get_one(Job, twice))
    jobs.start_worker()
    jobs.wait_for_state(last, "done")
    assert len(jobs.saves(twice)) == 1
    assert jobs.workflow_status(dropped) is None
    assert jobs.saves(dropped) == []


def test_several_processes_may_make_the_tables_at_once(database_url, tmp_path):
    script = """
import sys
from app.db.migrate import upgrade
from app.db.session import Database
from app.jobs.engine import JobQueue, prepare_job_tables
database = Database(sys.argv[1])
upgrade(database)
prepare_job_tables(database)
prepare_job_tables(database)
"""
    processes = [subprocess.Popen([sys.executable, "-c", script, database_url], cwd=tmp_path) for _ in range(3)]
    assert [process.wait() for process in processes] == [0] * 3


@pytest.mark.parametrize("kind", ["postgres"])  # on SQLite the database's own lock is waited for, and no longer
def test_who_waits_for_a_maker_of_the_tables_that_hangs_is_told_so(jobs):
    with jobs.database.write_engine.connect() as hanging:
        hanging.execute(sa.text("SELECT pg_advisory_lock(:n)"), {"n": MIGRATION_LOCK})
        with pytest.raises(MigrationBusyError, match="more than 0 s"):
            prepare_job_tables(jobs.database, turn_seconds=0.1)
        hanging.execute(sa.text("SELECT pg_advisory_unlock(:n)"), {"n": MIGRATION_LOCK})
    prepare_job_tables(jobs.database)
