"""What a worker asks the pipeline for a region that a person drew, and what becomes of the answer."""

import json
import uuid

import pytest
import sqlalchemy as sa

from app.children.child_pool import ChildResult
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Run
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import answer, found_item
from tests.support.photographs import pair

HINTS = [{"point": [30, 20], "food": "apple"}, {"point": [60, 20], "food": "banana"}]
RING = [[5.0, 5.0], [80.0, 5.0], [80.0, 80.0]]


class FakeChildren:
    """The child pool without a child: remembers what it was asked, answers what it was told to."""

    def __init__(self):
        self.asked = []
        self.result = ChildResult("ok", answer())

    def run(self, request, on_stage, *, name="", is_alone=False):
        on_stage("match")
        self.asked.append(json.loads(json.dumps(request.arguments["options"]["hints"])))
        return self.result


@pytest.fixture
def children():
    return FakeChildren()


@pytest.fixture
def participant(phone, state, client):
    body = meal_metadata(hints=HINTS)
    phone.post(pair(), body)
    neighbour = [[200.0, 10.0], [250.0, 10.0], [250.0, 50.0]]
    estimates.save(state, body["id"], found_item(hint=0), found_item(90.0, hint=1, polygon=neighbour))
    return Speaker(client, phone.headers, body["id"])


@pytest.fixture
def work(state, settings, children, participant):
    """Do the newest job in the way of the worker, without its queue."""
    worker = EstimatePair(state.database, state.blobs, children, settings)

    def work():
        with state.database.read() as session:
            query = sa.select(Job).join(Meal).where(Meal.client_id == uuid.UUID(participant.meal_id))
            job = session.scalars(query.order_by(Job.enqueued_at.desc())).first()
        key = worker.compute(job.id)
        with state.database.write() as session:
            worker.save(session, job.id, worker.load(key))
        return job

    return work


def test_pipeline_is_asked_for_the_new_region_and_told_of_the_neighbours(participant, work, children):
    apple, banana = participant.items()
    participant.say("redraw", item=apple["id"], polygon=RING)
    children.result = ChildResult("ok", answer(found_item(240.0, hint=0, polygon=RING), found_item(1.0, hint=1)))
    job = work()
    assert job.purpose == "remeasure"
    (hints,) = children.asked
    assert [(hint["polygon"], hint["food"]) for hint in hints] == [([RING], "apple"), (banana["polygon"], "banana")]
    apple, banana = participant.items()
    assert (apple["volume_ml"], apple["flags"], banana["volume_ml"]) == (240.0, [], 90.0)
    assert participant.meal()["status"] == "estimated"


def test_parts_of_a_split_get_their_own_volumes(participant, work, children):
    apple, _ = participant.items()
    other = [[90.0, 5.0], [120.0, 5.0], [120.0, 40.0]]
    participant.say("split", item=apple["id"], parts=[{"polygon": RING}, {"polygon": other, "food": "pear"}])
    children.result = ChildResult("ok", answer(found_item(30.0, hint=1), found_item(70.0, hint=0)))
    work()
    parts = [item for item in participant.items() if item["origin"] == "split"]
    assert [(part["food"]["key"], part["volume_ml"]) for part in parts] == [("apple", 70.0), ("pear", 30.0)]
    assert [hint["food"] for hint in children.asked[0]] == ["apple", "pear", "banana"]


def test_added_point_is_measured(participant, work, children):
    participant.say("add", food="pear", region={"point": [300, 200]})
    assert participant.items()[-1]["flags"] == ["remeasuring"]
    children.result = ChildResult("ok", answer(found_item(55.0, hint=0)))
    work()
    added = participant.items()[-1]
    assert (added["origin"], added["volume_ml"], added["status"]) == ("added", 55.0, "confirmed")


def test_child_that_ends_badly_leaves_a_flag_and_the_meal_as_it_was(participant, work, children, state):
    apple, banana = participant.items()
    participant.say("redraw", item=apple["id"], polygon=RING)
    children.result = ChildResult("crashed")
    work()
    assert participant.items()[0]["flags"] == ["remeasure_failed"]
    assert participant.items()[1] == banana
    meal = participant.meal()
    assert (meal["status"], meal["failure"], meal["stage"]) == ("needs_review", None, None)
    with state.database.read() as session:
        purposes = [run.purpose for run in session.scalars(sa.select(Run).order_by(Run.created_at))]
    assert purposes == ["meal", "remeasure"]
