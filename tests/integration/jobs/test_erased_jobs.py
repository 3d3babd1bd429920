"""A meal is erased while a worker has its job: the worker goes on, and nothing of the meal comes back."""

import uuid

import sqlalchemy as sa

from app.db.models import Job, Meal
from app.db.queries import privacy
from app.services.delete_blobs import BlobDeleter
from app.services.erase import Eraser
from app.services.erasure_ledger import ErasureLedger, digest_of
from app.services.secret_box import SecretBox
from app.storage.local import LocalBlobStore
from tests.integration.jobs.conftest import wait_until
from tests.integration.persons import database_bytes

BOX = SecretBox("a key for tests only, of no worth")


def erase_meal_of(jobs, job_id, folder):
    eraser = Eraser(jobs.database, BOX, ErasureLedger(LocalBlobStore(folder / "erasures"), BOX))
    meal_id = jobs.meal(job_id).id
    receipt = eraser.carry_out_on_meal(eraser.intend("meal", "erase", meal_id), meal_id, None)
    assert receipt is not None
    assert digest_of(BOX, "meal", "erase", meal_id)
    return meal_id


def workflows_left(jobs, job_id):
    with jobs.database.read() as session:
        return sum(
            session.scalar(sa.select(sa.func.count()).select_from(table).where(column == str(job_id)))
            for table, column in privacy._workflow_columns(session)
        )


def test_job_whose_meal_is_erased_while_it_is_computed_leaves_nothing_and_the_worker_lives(jobs, tmp_path):
    job_id = jobs.add("hold")
    worker = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-*")
    meal_id = erase_meal_of(jobs, job_id, tmp_path)
    assert workflows_left(jobs, job_id) == 0
    jobs.go(job_id)
    following = jobs.add()
    jobs.wait_for_state(following, "done")
    assert worker.poll() is None
    assert jobs.saves(job_id) == []
    deleter = BlobDeleter(jobs.database, LocalBlobStore(tmp_path / "blobs"))

    def is_swept():
        deleter.delete_orphans()
        deleter.delete_wanted()
        return jobs.database.empty_log() and not any(
            needle in database_bytes(jobs.database)
            for one in (meal_id, job_id)
            for needle in (str(one).encode(), one.hex.encode())
        )

    wait_until(is_swept, "DBOS's last rows of the job to be written and swept")
    with jobs.database.read() as session:
        assert session.get(Job, job_id) is None
        assert session.get(Meal, meal_id) is None
    assert workflows_left(jobs, following) > 0


def test_job_whose_meal_is_erased_while_it_waits_is_never_begun(jobs, tmp_path):
    job_id = jobs.add()
    erase_meal_of(jobs, job_id, tmp_path)
    jobs.start_worker()
    following = jobs.add()
    jobs.wait_for_state(following, "done")
    assert list(tmp_path.glob(f"computing-{job_id}-*")) == []
    assert workflows_left(jobs, job_id) == 0


def test_workflows_of_living_jobs_and_unknown_names_are_no_orphans(jobs):
    job_id = jobs.add()
    jobs.run_sql(f"UPDATE {jobs.workflow_table} SET name = name")
    with jobs.database.read() as session:
        assert privacy.workflows_without_job(session, 10) == []
    gone = uuid.uuid4()
    table = jobs.workflow_table.replace("workflow_status", "operation_outputs")
    jobs.run_sql(f"INSERT INTO {table} (workflow_uuid, function_id, function_name) VALUES ('{gone}', 1, 'compute')")
    jobs.run_sql(f"INSERT INTO {table} (workflow_uuid, function_id, function_name) VALUES ('nightly', 1, 'other')")
    with jobs.database.read() as session:
        assert privacy.workflows_without_job(session, 10) == [str(gone)]
    assert workflows_left(jobs, job_id) > 0
