"""On how many cores a worker has a meal estimated."""

import pytest
import sqlalchemy as sa

from app.children.child_pool import ChildResult
from app.estimates import estimate_meal
from app.estimates.estimate_meal import EstimateMeal
from app.meals.job_models import Job
from tests.integration.conftest import meal_metadata
from tests.integration.estimates.test_estimate_retries import Children
from tests.support.photographs import pair

WORKER = "worker-1"


@pytest.fixture
def four_cores(monkeypatch):
    monkeypatch.setattr(estimate_meal, "usable_cores", lambda: 4)


@pytest.fixture
def jobs(phone, state):
    """Three jobs, the first claimed by the worker, the others by another one."""
    for _ in range(3):
        assert phone.post(pair(), metadata=meal_metadata()).status_code == 202
    with state.database.write() as session:
        first, *others = session.scalars(sa.select(Job).order_by(Job.enqueued_at)).all()
        first.executor_id = WORKER
        for each in others:
            each.executor_id = "worker-2"
        return first.id, [each.id for each in others]


def give_to(state, executor_id, job_ids):
    with state.database.write() as session:
        session.execute(sa.update(Job).where(Job.id.in_(job_ids)).values(executor_id=executor_id))


def cores_of(state, job_id, *, concurrency=4, is_alone=False):
    children = Children(ChildResult("crashed"))
    settings = state.settings.model_copy(update={"worker_concurrency": concurrency})
    EstimateMeal(state.database, state.blobs, children, settings).compute(job_id, is_alone=is_alone)
    return children.cores


def test_only_job_has_all_cores(state, four_cores, jobs):
    assert cores_of(state, jobs[0]) == [4]


def test_worker_never_uses_more_cores_than_it_may_run_estimates(state, four_cores, jobs):
    assert cores_of(state, jobs[0], concurrency=2) == [2]


def test_jobs_of_a_worker_share_its_cores(state, four_cores, jobs):
    give_to(state, WORKER, jobs[1][:1])
    assert cores_of(state, jobs[0]) == [2]


def test_waiting_jobs_find_idle_cores(state, four_cores, jobs):
    give_to(state, None, jobs[1])
    assert cores_of(state, jobs[0]) == [4]
    assert cores_of(state, jobs[0], concurrency=3) == [1]


def test_job_that_is_tried_alone_because_the_machine_is_full_has_one_core(state, four_cores, jobs):
    assert cores_of(state, jobs[0], is_alone=True) == [1]


def test_background_job_has_one_core(state, four_cores, jobs):
    with state.database.write() as session:
        session.execute(sa.update(Job).values(is_background=True))
    assert cores_of(state, jobs[0]) == [1]
