"""A meal is erased while a worker has its job: the worker goes on, and nothing of the meal comes back."""

import pytest

from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.people.access.secret_box import SecretBox
from app.privacy.delete_blobs import BlobDeleter
from app.privacy.erase import Eraser
from app.privacy.erasure_ledger import ErasureLedger
from app.storage.local import LocalBlobStore
from tests.integration.people.persons import database_bytes
from tests.support.waiting import wait_until

BOX = SecretBox("a key for tests only, of no worth")


def erase_meal_of(jobs, job_id, folder):
    eraser = Eraser(jobs.database, BOX, ErasureLedger(LocalBlobStore(folder / "erasures"), BOX))
    meal_id = jobs.meal(job_id).id
    assert eraser.carry_out_on_meal(eraser.intend("meal", "erase", meal_id), meal_id, None) is not None
    return meal_id


@pytest.mark.both_stores
def test_job_whose_meal_is_erased_while_it_waits_is_never_begun_and_while_it_is_computed_leaves_nothing(jobs, tmp_path):
    waiting, job_id = jobs.add(), jobs.add("hold")
    erase_meal_of(jobs, waiting, tmp_path)
    worker = jobs.start_worker()
    jobs.wait_for_file(f"computing-{job_id}-*")
    meal_id = erase_meal_of(jobs, job_id, tmp_path)
    jobs.go(job_id)
    following = jobs.add()
    jobs.wait_for_state(following, "done")
    assert worker.poll() is None
    assert jobs.saves(job_id) == []
    assert list(tmp_path.glob(f"computing-{waiting}-*")) == []
    deleter = BlobDeleter(jobs.database, LocalBlobStore(tmp_path / "blobs"))

    def is_swept():
        deleter.delete_orphans()
        deleter.delete_scheduled()
        return jobs.database.empty_log() and not any(
            needle in database_bytes(jobs.database)
            for one in (meal_id, job_id)
            for needle in (str(one).encode(), one.hex.encode())
        )

    wait_until(is_swept, "what the worker still wrote to be swept")
    with jobs.database.read() as session:
        assert session.get(Job, job_id) is None
        assert session.get(Meal, meal_id) is None
