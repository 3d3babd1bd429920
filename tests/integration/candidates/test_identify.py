"""The worker's identification: what it goes by, what it learns from whom, and that it fails no meal."""

import uuid
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
import sqlalchemy as sa
from structlog.testing import capture_logs

from app.candidates.identify import IdentifyFoods
from app.candidates.queries import changed_entries
from app.children.child_pool import ChildResult
from app.identification.food_index import shipped_index
from app.jobs import queries as jobs
from app.meals.estimate.estimate_pair import EstimatePair
from app.meals.stored.identification_models import ItemIdentification
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.run_answer import RunAnswer
from app.people.models import Study
from app.vision.looks.vcm import LENGTHS
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support.estimates import answer, found_item, vcm
from tests.support.looks import vectors_at
from tests.support.photographs import pair

pytestmark = pytest.mark.slow

NEW_FOOD = "litchi"
NOON, EVENING = "2026-11-20T12:00:00+08:00", "2026-11-20T19:00:00+08:00"


@pytest.fixture(scope="module")
def known():
    """The shipped index."""
    return shipped_index()


@pytest.fixture(scope="module")
def index(known):
    """The shipped index as if it had never seen a litchi."""
    unknown = next(place for place, food in enumerate(known.foods) if food.food_key == NEW_FOOD)
    kept = np.flatnonzero(known.labels != unknown)
    labels = known.labels[kept]
    return replace(
        known,
        version="without litchis",
        foods=tuple(food for food in known.foods if food.food_key != NEW_FOOD),
        examples=known.examples[kept],
        labels=labels - (labels > unknown),
        specimens=tuple(known.specimens[row] for row in kept),
    )


@pytest.fixture(scope="module")
def looks(known):
    """Real vectors of a food, a list for each specimen."""

    def looks(food_key):
        place = next(place for place, food in enumerate(known.foods) if food.food_key == food_key)
        rows = np.flatnonzero(known.labels == place)
        specimens = dict.fromkeys(known.specimens[row] for row in rows)
        names = np.array(known.specimens)
        return [list(vectors_at(known, rows[names[rows] == one])) for one in specimens]

    return looks


class SeeingChildren:
    """Children that see what they are told to."""

    def __init__(self):
        self.items = []

    def run(self, request, on_stage, *, seconds=None, name="", is_alone=False):
        on_stage("read")
        return ChildResult("ok", answer(*self.items))


class Kitchen:
    """A worker, and meals that come to it: each is estimated at once, in the way of the worker."""

    def __init__(self, state, settings, index):
        self.state, self.settings, self.index = state, settings, index
        self.children = SeeingChildren()
        self.worker = EstimatePair(state.database, state.blobs, self.children, settings, lambda: index)

    def serve(self, phone, *vectors, volume_ml=20.0, **fields):
        """A meal of what looks so."""
        body = meal_metadata(**fields)
        assert phone.post(pair(), body).status_code == 202
        self.children.items = [found_item(volume_ml, None, vcm=vcm(*vector)) for vector in vectors]
        self.work()
        return Speaker(phone.client, phone.headers, body["id"])

    def work(self):
        with self.state.database.read() as session:
            query = sa.select(Job).where(Job.state == "queued").order_by(Job.enqueued_at.desc())
            job_id = session.scalars(query).first().id
        key = self.worker.compute(job_id)
        with self.state.database.write() as session:
            self.worker.save(session, job_id, self.worker.load(key))
            jobs.finish_job(session.get_one(Job, job_id), datetime.now(UTC))

    def told(self, phone, food, *vectors, **fields):
        """A meal whose only food a person has named."""
        meal = self.serve(phone, *vectors, **fields)
        for item in meal.items():
            meal.say("set_food", item=item["id"], food=food)
        return meal


@pytest.fixture
def kitchen(state, settings, index):
    return Kitchen(state, settings, index)


def keys(item):
    return [one["food"]["key"] for one in item["candidates"]]


def test_known_food_is_found_at_once_and_candidates_and_the_rest_add_up(kitchen, phone, looks):
    meal = kitchen.serve(phone, looks("banana")[0][0], volume_ml=150.0)
    (item,) = meal.items()
    assert (item["food"]["key"], item["flags"]) == ("banana", ["food_identified"])
    meal.say("confirm", item=item["id"])
    assert meal.meal()["status"] == "confirmed"
    (item,) = kitchen.serve(phone, looks("mooncake")[0][0]).items()
    assert "mooncake" not in keys(item)  # no table has it
    assert item["none_of_these"] > 0.9
    (item,) = kitchen.serve(phone, looks("peach")[0][0]).items()
    probabilities = [one["probability"] for one in item["candidates"]]
    assert probabilities == sorted(probabilities, reverse=True)
    assert sum(probabilities) + item["none_of_these"] == pytest.approx(1.0, abs=0.01)  # those below 0.001 are left out


def test_rejected_and_erased_items_are_forgotten_at_the_next_meal(kitchen, phone, looks):
    first, second, _ = looks(NEW_FOOD)
    meals = [kitchen.told(phone, NEW_FOOD, vector) for vector in first[:2]]
    assert NEW_FOOD in keys(kitchen.serve(phone, second[0]).items()[0])
    meals[0].say("reject", item=meals[0].items()[0]["id"])
    (item,) = kitchen.serve(phone, second[0]).items()
    assert item["index_version"].startswith("without litchis + 1 confirmed ")
    path = f"/v1/meals/{meals[1].meal_id}"
    assert phone.client.delete(path, headers=phone.headers | {"If-Match": "*"}).status_code in (200, 202, 204)
    (item,) = kitchen.serve(phone, second[0]).items()
    assert (NEW_FOOD in keys(item), item["index_version"]) == (False, "without litchis")


def share(state, study, *, is_shared=True):
    with state.database.write() as session:
        session.execute(sa.update(Study).where(Study.code == study).values(shares_index=is_shared))


def test_study_that_shares_learns_from_nobody_by_that(kitchen, enrol, looks, state):
    here, there = enrol("P001", study="here"), enrol("P002", study="there")
    kitchen.told(there, NEW_FOOD, looks(NEW_FOOD)[0][0])
    share(state, "here")
    assert NEW_FOOD not in keys(kitchen.serve(here, looks(NEW_FOOD)[1][0]).items()[0])


@pytest.fixture
def between(looks):
    """What looks half like a peach and half like a plum."""
    return (looks("peach")[0][0] + looks("plum")[0][0]) / 2


def ratio(meal):
    """How much likelier a plum is than a peach."""
    found = {one["food"]["key"]: one["probability"] for one in meal.items()[0]["candidates"]}
    return found["plum"] / found["peach"]


def declare(phone, food, captured_at):
    body = meal_metadata(captured_at=captured_at, items=[{"food": food, "amount": {"mass_g": 60.0}}])
    answered = phone.client.post("/v1/declared-meals", headers=phone.headers, json=body)
    assert answered.status_code == 201, answered.text


def test_what_a_participant_eats_moves_the_ranking_of_two_look_alikes(kitchen, enrol, between):
    phone, other = enrol("P001"), enrol("P002")
    before = ratio(kitchen.serve(phone, between, captured_at=NOON))
    for _ in range(8):
        declare(phone, "plum", NOON)
    assert ratio(kitchen.serve(phone, between, captured_at=NOON)) > 2 * before
    assert ratio(kitchen.serve(other, between, captured_at=NOON)) == pytest.approx(before)


def test_time_of_day_moves_the_ranking_of_two_look_alikes(kitchen, phone, between):
    for _ in range(8):
        declare(phone, "peach", NOON)
        declare(phone, "plum", EVENING)
    assert ratio(kitchen.serve(phone, between, captured_at=EVENING)) > 1.3 * ratio(
        kitchen.serve(phone, between, captured_at=NOON)
    )


def test_food_that_only_the_server_has_named_is_no_habit(kitchen, phone, looks, between):
    before = ratio(kitchen.serve(phone, between, captured_at=NOON))
    for vector in looks("plum")[1][:4]:
        meal = kitchen.serve(phone, vector, captured_at=NOON)
        (item,) = meal.items()
        assert (item["food"]["key"], item["flags"]) == ("plum", ["food_identified"])
        meal.say("set_volume", item=item["id"], volume_ml=30.0)
    assert ratio(kitchen.serve(phone, between, captured_at=NOON)) == pytest.approx(before)


def test_meal_is_no_evidence_for_itself(kitchen, phone, looks):
    first, second, _ = looks(NEW_FOOD)
    meal = kitchen.told(phone, NEW_FOOD, first[0])
    meal.say("redraw", item=meal.items()[0]["id"], polygon=[[5.0, 5.0], [80.0, 5.0], [80.0, 80.0]])
    kitchen.children.items = [found_item(20.0, 0, vcm=vcm(*second[0]))]
    kitchen.work()
    (item,) = meal.items()
    assert (NEW_FOOD in keys(item), item["index_version"]) == (False, "without litchis")
    assert NEW_FOOD in keys(kitchen.serve(phone, second[1]).items()[0])


def test_meal_is_estimated_without_candidates_where_it_cannot_be_identified(kitchen, state, settings, phone, looks):
    for vector in ([], [1.0, 2.0]):
        with capture_logs() as logs:
            meal = kitchen.serve(phone, vector)
        assert [line["event"] for line in logs if line["log_level"] == "error"] == ["identify_failed"]
        (item,) = meal.items()
        assert (item["candidates"], item["volume_ml"], meal.meal()["status"]) == ([], 20.0, "needs_review")
    (item,) = Kitchen(state, settings, None).serve(phone, looks("banana")[0][0]).items()  # there is no index
    assert (item["candidates"], item["none_of_these"]) == ([], None)
    body = meal_metadata()
    phone.post(pair(), body)
    kitchen.children.items = [found_item(20.0, None, vcm=vcm(*looks("banana")[0][0], version="0"))]
    kitchen.work()
    (item,) = Speaker(phone.client, phone.headers, body["id"]).items()
    assert (item["candidates"], item["none_of_these"]) == ([], None)


def test_entry_that_cannot_be_read_is_left_out_and_the_others_count(kitchen, phone, looks, state):
    first, second, _ = looks(NEW_FOOD)
    broken = kitchen.told(phone, "kiwifruit", looks("kiwifruit")[0][0])
    kitchen.told(phone, NEW_FOOD, first[0])
    for vector in (b"", np.full(374, np.nan, "<f2").tobytes()):
        with state.database.write() as session:
            of_broken = uuid.UUID(broken.items()[0]["id"])
            session.execute(
                sa.update(ItemIdentification).where(ItemIdentification.item_id == of_broken).values(vector=vector)
            )
        (item,) = Kitchen(state, kitchen.settings, kitchen.index).serve(phone, second[0]).items()
        assert NEW_FOOD in keys(item)
        assert item["index_version"].startswith("without litchis + 1 confirmed ")


def test_database_that_is_away_while_a_meal_is_identified_costs_no_candidates(kitchen, phone, looks, monkeypatch):
    body = meal_metadata()
    phone.post(pair(), body)
    kitchen.children.items = [found_item(20.0, None, vcm=vcm(*looks("banana")[0][0]))]

    def away(*_arguments, **_options):
        raise sa.exc.OperationalError("SELECT", None, Exception("the server closed the connection"))

    with monkeypatch.context() as patch:
        patch.setattr("app.candidates.identify.index_entries.studies_for", away)
        with pytest.raises(sa.exc.OperationalError):
            kitchen.work()
    kitchen.work()
    (item,) = Speaker(phone.client, phone.headers, body["id"]).items()
    assert keys(item)[0] == "banana"


@pytest.mark.both_stores
def test_only_entries_that_have_changed_are_read_again(kitchen, enrol, state, index, looks, monkeypatch):
    read = []

    def entries_read(*arguments):
        for part in changed_entries(*arguments):
            read.extend(str(row.item_id) for row in part if row.vector is not None)
            yield part

    monkeypatch.setattr("app.candidates.identify.index_entries.changed_entries", entries_read)
    service = IdentifyFoods(state.database, lambda: index)
    phone, sharing = enrol("P001"), enrol("P002", study="sharing")
    share(state, "sharing")

    def identify():
        read.clear()
        with state.database.read() as session:
            meal = session.scalars(sa.select(Meal).where(Meal.client_id == uuid.UUID(asked.meal_id))).one()
        found = RunAnswer.model_validate(answer(found_item(20.0, None, vcm=vcm(*looks(NEW_FOOD)[2][0]))))
        service.add_candidates(meal, found)
        return found.items[0].index_version, sorted(read)

    told = [
        kitchen.told(who, NEW_FOOD, vector) for who, vector in zip((phone, sharing), looks(NEW_FOOD)[0], strict=False)
    ]
    items = [meal.items()[0]["id"] for meal in told]
    asked = kitchen.serve(phone, looks(NEW_FOOD)[0][1])
    first, all_of_them = identify()
    assert all_of_them == sorted(items)
    assert identify() == (first, [])
    for meal, item in zip(told, items, strict=True):
        meal.say("set_food", item=item, food="plum")
        changed, again = identify()
        assert (changed != first, again) == (True, [item])
        first = changed
    told[0].say("reject", item=items[0])
    changed, again = identify()
    assert (changed.startswith("without litchis + 1 confirmed "), again) == (True, [])


def test_study_beyond_the_room_is_forgotten_and_read_again(kitchen, enrol, looks, monkeypatch):
    monkeypatch.setattr("app.candidates.identify.MOST_HELD", 0)
    here, there = enrol("P001", study="here"), enrol("P002", study="there")
    kitchen.told(here, NEW_FOOD, looks(NEW_FOOD)[0][0])
    held = kitchen.worker._identify._learned._learned
    for phone, is_known in ((here, True), (there, False), (here, True)):
        assert (NEW_FOOD in keys(kitchen.serve(phone, looks(NEW_FOOD)[1][0]).items()[0])) is is_known
        assert len(held) == 1


def test_vector_of_an_earlier_version_still_teaches_what_it_holds(kitchen, phone, looks):
    first, second, _ = looks(NEW_FOOD)
    body = meal_metadata()
    phone.post(pair(), body)
    kitchen.children.items = [found_item(20.0, None, vcm=vcm(*first[0][: LENGTHS["1"]], version="1"))]
    kitchen.work()
    meal = Speaker(phone.client, phone.headers, body["id"])
    (item,) = meal.items()
    assert item["candidates"] == []
    meal.say("set_food", item=item["id"], food=NEW_FOOD)
    (item,) = kitchen.serve(phone, second[0]).items()
    assert NEW_FOOD in keys(item)
    assert item["index_version"].startswith("without litchis + 1 confirmed ")


@pytest.mark.parametrize(
    ("source", "declared", "is_doubted"), [("marker", 2.0, True), ("marker", 1.0, False), ("rig", 2.0, False)]
)
@pytest.mark.parametrize("hint", [0, None])
def test_marker_that_was_declared_at_twice_its_size_is_doubted(
    kitchen, phone, state, known, looks, source, declared, is_doubted, hint
):
    kitchen.serve(phone, looks("apple")[0][0], hints=[{"point": [30, 20], "food": "apple"}])
    with state.database.read() as session:
        meal = session.scalars(sa.select(Meal)).one()
    item = found_item(280.0 * declared**3, hint, vcm=vcm(*looks("apple")[1][0]))
    parameters = {
        "scale_source": source,
        "camera_height_first_mm": 350.0 * declared,
        "rim_radii_mm": {"plate": [125.0 * declared]},
    }
    found = RunAnswer.model_validate(answer(item, parameters=parameters))
    IdentifyFoods(state.database, lambda: known).add_candidates(meal, found)
    assert ("scale_doubtful" in found.items[0].flags) is is_doubted
    assert found.parameters.get("plausible_scale_factor", 1.0) == pytest.approx(0.5 if is_doubted else 1.0, abs=0.07)


def test_candidates_say_what_counts_beside_their_looks_and_a_study_can_do_without(kitchen, phone, looks, state):
    banana, plum = looks("banana")[0][0], looks("plum")[0][0]
    meal = kitchen.serve(phone, banana, plum, captured_at=NOON)
    for item, food in zip(meal.items(), ("banana", "plum"), strict=True):
        meal.say("set_food", item=item["id"], food=food)

    def reasons():
        hints = [{"point": [3, 3]}, {"point": [200, 200], "food": "plum"}]
        body = meal_metadata(captured_at=EVENING, hints=hints)
        assert phone.post(pair(), body).status_code == 202
        kitchen.children.items = [
            found_item(20.0, hint, vcm=vcm(*vector)) for hint, vector in enumerate((banana, plum))
        ]
        kitchen.work()
        (item, _) = Speaker(phone.client, phone.headers, body["id"]).items()
        return {one["food"]["key"]: one["reasons"] for one in item["candidates"]}

    assert {"eaten_before", "eaten_with"} <= set(reasons()["banana"])
    with state.database.write() as session:
        session.execute(sa.update(Study).values(identifies_by_context=False))
    assert set(map(tuple, reasons().values())) == {()}
