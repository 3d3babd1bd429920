"""What an estimate's child may come to, and which of it is worth another try."""

import errno
import uuid

import pytest
from structlog.testing import capture_logs

from app.children.child_pool import ChildResult
from app.children.faults import BrokenOff, is_passing
from app.estimates.estimate_meal import AWAITS_ROOM, EstimateMeal
from tests.integration.conftest import meal_metadata
from tests.support.photographs import pair


class Children:
    def __init__(self, result):
        self.result = result
        self.alone = []
        self.cores = []

    def run(self, request, on_stage, *, name, is_alone):
        self.alone.append(is_alone)
        self.cores.append(request.arguments["cores"])
        return self.result


@pytest.fixture
def sent(phone):
    body = meal_metadata()
    answer = phone.post(pair(), metadata=body)
    assert answer.status_code == 202
    return f"/v1/meals/{body['id']}"


def job_of(state):
    from app.meals.job_models import Job

    with state.database.read() as session:
        return session.query(Job).one().id


@pytest.mark.parametrize("outcome", ["killed", "stalled", "timed_out"])
def test_estimate_that_the_machine_ended_is_worth_another_try_and_the_phone_sees_that_it_waits(
    phone, state, sent, outcome
):
    children = Children(ChildResult(outcome, limit="120 s"))
    work = EstimateMeal(state.database, state.blobs, children, state.settings)
    with pytest.raises(BrokenOff) as broken:
        work.compute(job_of(state), is_alone=True)
    assert children.alone == [True]
    assert broken.value.failure.code in ("estimate_killed", "estimate_timed_out")
    work.await_room(job_of(state))
    meal = phone.get(sent).json()
    assert (meal["status"], meal["stage"], meal["failure"]) == ("processing", AWAITS_ROOM, None)


@pytest.mark.parametrize(
    ("outcome", "code"), [("crashed", "estimate_crashed"), ("out_of_memory", "estimate_out_of_memory")]
)
def test_estimate_that_its_photographs_ended_is_not_tried_again(state, sent, outcome, code):
    children = Children(ChildResult(outcome, limit="3072 MiB"))
    key = EstimateMeal(state.database, state.blobs, children, state.settings).compute(job_of(state))
    answer = EstimateMeal(state.database, state.blobs, children, state.settings).load(key).answer
    assert answer.failure.code == code
    assert "{limit}" not in answer.failure.message


def test_disk_that_is_full_for_a_while_in_the_child_fails_no_meal(state, sent):
    """In a storm a full disk met the child at its output: the meal was `internal_error` at once."""
    children = Children(ChildResult("raised", message="OSError: no space left on device", errno=errno.ENOSPC))
    with pytest.raises(OSError, match="no space left") as full:
        EstimateMeal(state.database, state.blobs, children, state.settings).compute(job_of(state))
    assert is_passing(full.value)


def test_waiting_for_room_with_a_meal_that_was_erased_meanwhile_leaves_no_traceback(state):
    """A storm of killed children: the worker logged NoResultFound."""
    work = EstimateMeal(state.database, state.blobs, Children(None), state.settings)
    with capture_logs() as logs:
        work.await_room(uuid.uuid4())
    assert logs == []
