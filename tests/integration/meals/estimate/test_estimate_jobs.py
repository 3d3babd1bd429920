"""How a worker has a meal estimated: which ends of a child are worth another try."""

import errno
import uuid

import pytest
import sqlalchemy as sa
from structlog.testing import capture_logs

from app.children.child_pool import ChildResult
from app.children.faults import BrokenOff, JobFailure, is_passing
from app.meals.estimate.estimate_pair import AWAITS_ROOM, EstimatePair
from app.meals.stored.job_models import Job
from app.meals.stored.models import MealImage
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair


class Children:
    def __init__(self, result):
        self.result = result
        self.alone = []

    def run(self, request, on_stage, *, name, is_alone):
        self.alone.append(is_alone)
        return self.result


@pytest.fixture
def sent(phone):
    body = meal_metadata()
    answer = phone.post(pair(), metadata=body)
    assert answer.status_code == 202
    return f"/v1/meals/{body['id']}"


@pytest.fixture
def job_id(sent, state):
    with state.database.read() as session:
        return session.query(Job).one().id


@pytest.mark.parametrize("outcome", ["killed", "stalled", "timed_out"])
def test_estimate_that_the_machine_ended_is_worth_another_try_and_the_phone_sees_that_it_waits(
    phone, state, sent, job_id, outcome
):
    """Of a meal that was erased meanwhile nothing is said: a worker once logged NoResultFound."""
    children = Children(ChildResult(outcome, limit="120 s"))
    work = EstimatePair(state.database, state.blobs, children, state.settings)
    with pytest.raises(BrokenOff) as broken:
        work.compute(job_id, is_alone=True)
    assert children.alone == [True]
    assert broken.value.failure.code in ("estimate_killed", "estimate_timed_out")
    work.await_room(job_id)
    meal = phone.get(sent).json()
    assert (meal["status"], meal["stage"], meal["failure"]) == ("processing", AWAITS_ROOM, None)
    with capture_logs() as logs:
        work.await_room(uuid.uuid4())
    assert logs == []


def test_estimate_that_its_photographs_ended_is_not_tried_again(state, job_id):
    for outcome, code in (("crashed", "estimate_crashed"), ("out_of_memory", "estimate_out_of_memory")):
        children = Children(ChildResult(outcome, limit="3072 MiB"))
        work = EstimatePair(state.database, state.blobs, children, state.settings)
        answer = work.load(work.compute(job_id)).answer
        assert answer.failure.code == code
        assert "{limit}" not in answer.failure.message


def test_disk_that_is_full_for_a_while_in_the_child_fails_no_meal(state, job_id):
    """In a storm a full disk met the child at its output: the meal was `internal_error` at once."""
    children = Children(ChildResult("raised", message="OSError: no space left on device", errno=errno.ENOSPC))
    with pytest.raises(OSError, match="no space left") as full:
        EstimatePair(state.database, state.blobs, children, state.settings).compute(job_id)
    assert is_passing(full.value)


def test_photograph_that_the_store_has_lost_fails_its_meal_by_name(state, job_id):
    with state.database.read() as session:
        image = session.scalars(sa.select(MealImage)).first()
    state.blobs.delete(image.blob_key)
    work = EstimatePair(state.database, state.blobs, Children(ChildResult("crashed")), state.settings)
    with pytest.raises(JobFailure) as lost:
        work.compute(job_id)
    assert lost.value.failure.code == "photograph_missing"
