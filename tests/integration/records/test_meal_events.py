"""Random words of random people about one meal: the records are always those that a rebuild from nothing gives."""

import functools
import uuid

import pytest
import sqlalchemy as sa
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from app.core.errors import PreconditionFailedError, TadaError
from app.meals.stored.event_models import MealEvent
from app.meals.stored.identification_models import IndexEntry
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item
from app.people.access.caller import DeviceCaller, StaffCaller
from app.people.models import Device, Participant, Staff
from app.records.recompute_records import rebuild_records
from app.records.review.meal_events import MealEvents
from app.records.review.schemas import EventIn
from tests.integration.conftest import meal_metadata
from tests.integration.records.at_once import at_once
from tests.support import estimates
from tests.support.estimates import identified_item, scene_artefact, unmeasured_item, vcm
from tests.support.photographs import pair

HINTS = [{"point": [30, 20], "food": "apple"}, {"point": [60, 20], "food": "milk-whole"}, {"point": [90, 20]}]
RING = [[5.0, 5.0], [80.0, 5.0], [80.0, 80.0]]
HAND_FORM = {"section": "slab", "centre_mm": [9.5, 0.0], "length_mm": 60.0, "width_mm": 40.0, "yaw_deg": 30.0}
FOODS = ("banana", "potatoes-boiled", "butter", "no-such-food")
NO_FOOD = {"food": None, "lies_as": None}
EVENT = TypeAdapter(EventIn)


def new_event(kind, **fields):
    return EVENT.validate_python({"id": uuid.uuid4(), "kind": kind, **fields})


class Table:
    """One meal at a time of one participant, those who speak of it, and what they can say."""

    def __init__(self, state, phone):
        self.state = state
        self.phone = phone
        with state.database.read() as session:
            person = session.scalars(sa.select(Participant)).one()
            device = session.scalars(sa.select(Device)).one()
            staff = session.scalars(sa.select(Staff)).one()
        self.participant = DeviceCaller(device.id, person.id, person.study_id, person.alias)
        self.reviewer = StaffCaller(staff.id, staff.name, is_admin=True, token_id=uuid.uuid4())
        self.client_id = None

    def lay(self):
        """A new meal, estimated: an apple, milk that could not be measured, and what the index takes for a banana."""
        body = meal_metadata(hints=HINTS)
        assert self.phone.post(pair(), body).status_code == 202
        apple = identified_item({"apple": 0.9, "pear": 0.05}, hint=0)
        banana = identified_item({"banana": 0.85, "pear": 0.1}, volume_ml=90.0, hint=2)
        milk = unmeasured_item(hint=1) | {"vcm": vcm(1.0, 0.0)}
        estimates.save(self.state, body["id"], apple, milk, banana, artefacts=[scene_artefact(self.state)])
        self.client_id = uuid.UUID(body["id"])

    def send(self, caller, kind, expected=None, **fields):
        event = new_event(kind, **fields)
        return self.state.part(MealEvents).append(caller, self.client_id, event, expected=expected)[0]

    def rows(self, model):
        with self.state.database.read() as session:
            meal = sa.select(Meal.id).where(Meal.client_id == self.client_id).scalar_subquery()
            return list(session.scalars(sa.select(model).where(model.meal_id == meal)))

    def rows_of_items(self, model):
        items = [item.id for item in self.rows(Item)]
        with self.state.database.read() as session:
            return list(session.scalars(sa.select(model).where(model.item_id.in_(items))))

    def items(self):
        return sorted(self.rows(Item), key=lambda item: item.position)

    def measure_what_was_drawn(self, volume_ml):
        """Do the waiting jobs in the way of the worker."""
        for job in self.rows(Job):
            if job.purpose == "remeasure" and job.state == "queued":
                drawn = [item for item in self.items() if item.event_id == job.event_id] or [self._redrawn(job)]
                count = len(drawn) if volume_ml else 0
                likely = {"pear": 0.9 if count == 1 else 0.5}
                found = [identified_item(likely, volume_ml=volume_ml, hint=number) for number in range(count)]
                regions = [str(item.id) for item in drawn]
                estimates.save(self.state, self.client_id, *found, purpose="remeasure", regions=regions)

    def _redrawn(self, job):
        event = next(event for event in self.rows(MealEvent) if event.id == job.event_id)
        return next(item for item in self.items() if item.id == event.item_id)


@pytest.fixture
def table(state, phone):
    return Table(state, phone)


NUMBERS = st.integers(0, 99)
KINDS = (
    "confirm", "reject", "set_food", "set_volume", "set_mass", "set_share", "confirm_meal", "split", "merge", "redraw",
    "reshape", "add", "declare", "undo", "measure",
)  # fmt: skip
STEPS = st.lists(st.tuples(st.sampled_from(KINDS), st.booleans(), NUMBERS, NUMBERS), min_size=8, max_size=20)


def event_fields(kind, one, other, items, events):
    """The fields of an event of this kind; numbers choose among the items, foods and amounts."""
    item, second = items[one % len(items)].id, items[(one + 1 + other) % len(items)].id
    food, amount = FOODS[other % len(FOODS)], {"mass_g": 1.0 + other, "relative_sd": 0.1}
    share, ring = (1 + other % 98) / 100, RING if one % 2 else None
    parts = [{"share": share, "polygon": ring} | NO_FOOD, {"share": 1 - share, "polygon": None} | NO_FOOD]
    region, known = {"polygon": RING} if one % 2 else None, amount if other % 2 else None
    fields = {
        "set_food": {"food": food, "lies_as": None},
        "set_volume": {"volume_ml": 1.0 + other},
        "set_mass": amount,
        "set_share": {"share": share},
        "split": {"parts": parts},
        "merge": {"items": [str(item), str(second)], "food": FOODS[other % 3], "lies_as": None},
        "redraw": {"polygon": RING},
        "reshape": {"form": HAND_FORM | {"height_mm": 10.0 + other}},
        "add": {"food": food, "lies_as": None, "region": region, "amount": known, "share": 1.0},
        "declare": {"probe": "fat_added", "answer": "yes", "food": "butter", "amount": amount, "share": None},
        "undo": {"event": str(events[other % len(events)].id) if events else str(uuid.uuid4())},
    }
    about = {} if kind in ("merge", "add", "confirm_meal", "undo") else {"item": item}
    return about | fields.get(kind, {})


def take(table, kind, by_reviewer, one, other):
    """Send the event; return the error if it is refused, else None."""
    if kind == "measure":
        table.measure_what_was_drawn(float(other) if other % 3 else None)
        return None
    fields = event_fields(kind, one, other, table.items(), table.rows(MealEvent))
    try:
        table.send(table.reviewer if by_reviewer else table.participant, kind, **fields)
    except (TadaError, ValidationError) as error:
        return error
    return None


@pytest.mark.slow
@settings(
    max_examples=10,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(steps=STEPS)
def test_records_after_any_events_equal_a_rebuild(table, steps):
    table.lay()
    for step in steps:
        before = len(table.rows(MealEvent)), len(table.items())
        refusal = take(table, *step)
        if refusal is not None:
            assert isinstance(refusal, ValidationError) or refusal.status in (403, 404, 409, 422)
            assert (len(table.rows(MealEvent)), len(table.items())) == before
        settled = [row for row in table.rows(EffectiveRecord) if row.status in ("confirmed", "corrected")]
        assert all(row.consumed_g is not None for row in settled)
        learned = table.rows_of_items(IndexEntry)
        assert {entry.item_id for entry in learned} <= {row.item_id for row in settled}
        assert not {entry.item_id for entry in learned} & {r.item_id for r in settled if "food_identified" in r.flags}
    assert rebuild_records(table.state.database, write=False).different == 0


def test_of_edits_of_one_version_one_wins_and_the_others_are_told_so(table):
    table.lay()
    item = table.items()[0].id
    with table.state.database.read() as session:
        version = session.scalar(sa.select(Meal.version).where(Meal.client_id == table.client_id))

    def edit(food):
        try:
            table.send(table.participant, "set_food", item=item, expected=frozenset({version}), food=food)
        except PreconditionFailedError as error:
            return error.facts["version"]
        return food

    foods = ("banana", "pear", "orange", "apple")
    outcomes = at_once(*(functools.partial(edit, food) for food in foods))
    (winner,) = set(outcomes) & set(foods)
    assert sorted(outcome for outcome in outcomes if outcome != winner) == [version + 1] * 3
    assert [event.new["food"] for event in table.rows(MealEvent)] == [winner]


def test_one_event_sent_thrice_at_the_same_time_is_one(table):
    table.lay()
    event = new_event("set_food", item=table.items()[0].id, food="banana")
    append = table.state.part(MealEvents).append
    news = at_once(*[lambda: append(table.participant, table.client_id, event, expected=None)[1]] * 3)
    assert sorted(news) == [False, False, True]
    assert len(table.rows(MealEvent)) == 1
