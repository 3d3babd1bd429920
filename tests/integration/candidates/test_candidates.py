"""What the index says of an item, from the sealed answer to what people see, and what follows from it."""

import uuid

import pytest
import sqlalchemy as sa

from app.meals.stored.identification_models import IndexEntry, ItemIdentification
from app.meals.stored.job_models import Job
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item, ItemCandidate, ItemFood
from app.records.recompute_records import rebuild_records
from app.vision.looks.vcm import VCM_VERSION
from tests.integration.conftest import meal_metadata
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import found_item, identified_item, vcm
from tests.support.photographs import pair

RING = [[5.0, 5.0], [80.0, 5.0], [80.0, 80.0]]
LOOKS = vcm(0.25, -1.0, 3.0)
UNSURE = {"apple": 0.5, "pear": 0.3, "peach": 0.1}
SURE = {"apple": 0.9, "pear": 0.05}


@pytest.fixture
def meal_of(phone, state, client):
    """A meal with these items; hints: what the phone pointed at."""

    def meal_of(*items, hints=(), **fields):
        body = meal_metadata(hints=list(hints), **fields)
        assert phone.post(pair(), body).status_code == 202
        estimates.save(state, body["id"], *items)
        return Speaker(client, phone.headers, body["id"])

    return meal_of


@pytest.fixture
def rows(state):
    """All rows of a table."""

    def rows(model, *order):
        with state.database.read() as session:
            return list(session.scalars(sa.select(model).order_by(*order)))

    return rows


@pytest.fixture
def remeasure(state):
    """The answer to what a person drew last."""

    def remeasure(speaker, *found):
        with state.database.read() as session:
            query = sa.select(Job).where(Job.purpose == "remeasure", Job.state == "queued")
            event_id = session.scalars(query).one().event_id
            drawn = [item.id for item in session.scalars(sa.select(Item).where(Item.event_id == event_id))]
        regions = [str(item) for item in drawn] or [speaker.items()[0]["id"]]
        return estimates.save(state, speaker.meal_id, *found, purpose="remeasure", regions=regions)

    return remeasure


def shown(item):
    return [(one["food"]["key"], one["probability"], one["source"]) for one in item["candidates"]]


def test_candidates_are_kept_once_with_run_and_index_and_shown(meal_of, rows, client, admin, state):
    found = identified_item(UNSURE, none=0.1, vcm=LOOKS)
    meal = meal_of(found)
    (item,) = meal.items()
    assert shown(item) == [("apple", 0.5, "index"), ("pear", 0.3, "index"), ("peach", 0.1, "index")]
    assert (item["none_of_these"], item["index_version"]) == (0.1, "test 1")
    (kept,) = rows(ItemIdentification)
    assert (kept.vcm_version, kept.index_version, kept.none_probability) == (VCM_VERSION, "test 1", 0.1)
    assert kept.vector.hex() == "003400bc0042"  # 0.25, -1 and 3 as little-endian float16
    assert {one.run_id for one in rows(ItemCandidate)} == {kept.run_id}
    (queued,) = client.get("/v1/studies/pilot/review-queue", headers=admin).json()["items"]
    assert (queued["candidates"], queued["none_of_these"]) == (item["candidates"], 0.1)
    before = [len(rows(model)) for model in (ItemCandidate, ItemIdentification, ItemFood)]
    estimates.save(state, uuid.UUID(meal.meal_id), found)
    assert [len(rows(model)) for model in (ItemCandidate, ItemIdentification, ItemFood)] == before


def test_item_that_was_not_identified_has_a_network_s_candidates_at_most_and_keeps_its_vector(meal_of, rows):
    (item,) = meal_of(found_item(hint=None)).items()
    assert (item["candidates"], item["none_of_these"], item["index_version"]) == ([], None, None)
    (item,) = meal_of(found_item(hint=None, **by_model({"plum": 0.97}))).items()
    assert (shown(item), item["none_of_these"]) == ([("plum", 0.97, "model")], None)
    assert rows(ItemIdentification) == []
    (item,) = meal_of(found_item(hint=None, vcm=LOOKS)).items()
    assert (item["candidates"], item["none_of_these"]) == ([], None)
    (kept,) = rows(ItemIdentification)
    assert (kept.index_version, kept.none_probability) == (None, None)


def test_item_is_taken_for_what_it_surely_is_with_the_doubt_that_it_is_another_and_waits_else(meal_of, rows):
    meal_of(found_item(hint=0), hints=[{"point": [3, 3], "food": "apple"}])
    for probability, specimens, food, status, flags in (
        (0.85, 3, "apple", "proposed", ["food_identified"]),
        (0.849, 30, None, "needs_review", []),
        (0.99, 2, None, "needs_review", []),
    ):
        (item,) = meal_of(identified_item({"apple": probability}, specimens=specimens)).items()
        assert (item["food"] and item["food"]["key"], item["status"], item["flags"]) == (food, status, flags)
        assert (item["mass_g"] is None) == (food is None)
    known, identified = sorted(record.doubt for record in rows(EffectiveRecord) if record.food_id is not None)
    assert 1 - identified == pytest.approx(0.85 * (1 - known))


def test_one_call_confirms_what_the_index_found_or_chooses_another_and_an_amount_vouches_for_no_food(meal_of, rows):
    meal = meal_of(identified_item(SURE))
    item_id = meal.items()[0]["id"]
    meal.say("set_volume", item=item_id, volume_ml=100.0)
    (item,) = meal.items()
    assert (item["status"], item["flags"]) == ("corrected", ["food_identified"])
    assert rows(IndexEntry) == []
    meal.say("set_food", item=item_id, food=item["candidates"][1]["food"]["key"])
    (item,) = meal.items()
    assert (item["status"], item["food"]["key"], item["flags"]) == ("corrected", "pear", [])
    meal = meal_of(identified_item(SURE))
    meal.say("confirm", item=meal.items()[0]["id"])
    (item,) = meal.items()
    assert (item["status"], item["food"]["key"], item["flags"]) == ("confirmed", "apple", [])


def test_hint_that_the_index_is_sure_against_is_doubtful_until_somebody_vouches(meal_of, rows):
    hints = [{"point": [3, 3], "food": "pear"}]
    meal_of(identified_item({"apple": 0.94, "pear": 0.05}, hint=0), hints=hints)
    meal = meal_of(identified_item({"apple": 0.96, "pear": 0.02}, hint=0), hints=hints)
    (item,) = meal.items()
    assert shown(item) == [("pear", None, "hint"), ("apple", 0.96, "index"), ("pear", 0.02, "index")]
    assert (item["food"]["key"], item["flags"]) == ("pear", ["food_doubtful"])
    believed, doubtful = sorted(record.doubt for record in rows(EffectiveRecord))
    assert believed < 0.3
    assert 1 - doubtful == pytest.approx(0.02 * (1 - believed))
    meal.say("confirm", item=item["id"])
    assert meal.items()[0]["flags"] == []


def test_candidates_are_ten_at_most_none_next_to_impossible_and_none_that_no_table_has(meal_of, client, admin):
    keys = [food["key"] for food in client.get("/v1/foods?limit=30", headers=admin).json()["items"]][:14]
    many = dict.fromkeys(keys[:12], 0.08)
    (item,) = meal_of(identified_item(many)).items()
    assert len(item["candidates"]) == 10
    (item,) = meal_of(identified_item({"apple": 0.5, "pear": 0.001, "peach": 0.0009})).items()
    assert [key for key, *_ in shown(item)] == ["apple", "pear"]
    (item,) = meal_of(identified_item({"mooncake": 0.85, "sachima": 0.1, "apple": 0.03}, none=0.02)).items()
    assert shown(item) == [("apple", 0.03, "index")]
    assert item["none_of_these"] == pytest.approx(0.97)
    assert item["food"] is None


def test_redrawn_region_that_is_surely_something_is_taken_for_it_as_long_as_nobody_has_said(meal_of, remeasure):
    meal = meal_of(identified_item(SURE))
    (item,) = meal.items()
    meal.say("redraw", item=item["id"], polygon=RING)
    remeasure(meal, identified_item({"peach": 0.85}, hint=0))
    (taken,) = meal.items()
    assert (taken["food"]["key"], taken["flags"]) == ("peach", ["food_identified"])
    drawing = meal.history()["items"][-1]["id"]
    meal.say("set_food", item=item["id"], food="pear")
    meal.say("redraw", item=item["id"], polygon=RING[::-1])
    remeasure(meal, identified_item({"peach": 0.99}, hint=0))
    assert meal.items()[0]["food"]["key"] == "pear"
    for event in meal.history()["items"][-2:]:
        meal.say("undo", event=event["id"])
    assert meal.items()[0]["food"]["key"] == "peach"
    meal.say("undo", event=drawing)
    assert meal.items()[0]["food"]["key"] == "apple"


def test_identified_food_lies_as_was_told_redrawn_too_and_an_added_region_is_identified(meal_of, remeasure):
    meal = meal_of(identified_item(SURE, hint=0), hints=[{"point": [3, 3], "lies_as": "heap"}])
    (item,) = meal.items()
    assert (item["food"]["key"], item["lies_as"]) == ("apple", "heap")
    meal.say("redraw", item=item["id"], polygon=RING)
    remeasure(meal, identified_item({"peach": 0.85}, hint=0))
    (item,) = meal.items()
    assert (item["food"]["key"], item["lies_as"]) == ("peach", "heap")
    meal.say("add", region={"polygon": RING})
    remeasure(meal, identified_item({"peach": 0.85, "plum": 0.1}, hint=0))
    added = meal.items()[-1]
    assert (added["food"]["key"], added["flags"]) == ("peach", ["food_identified"])
    assert shown(added) == [("peach", 0.85, "index"), ("plum", 0.1, "index")]


def test_parts_of_a_guessed_item_are_guessed_and_of_a_known_one_known(meal_of, rows):
    for probabilities, hints, flags in ((SURE, [], ["food_identified"]), (SURE, [{"food": "pear"}], [])):
        meal = meal_of(identified_item(probabilities, hint=0 if hints else None), hints=hints)
        meal.say("split", item=meal.items()[0]["id"], parts=[{"share": 0.4}, {"share": 0.6}])
        assert [part["flags"] for part in meal.items() if part["origin"] == "split"] == [flags, flags]
    merged = meal_of(identified_item(SURE), identified_item(SURE))
    merged.say("merge", items=[item["id"] for item in merged.items()])
    (whole,) = [item for item in merged.items() if item["origin"] == "merged"]
    assert (whole["food"]["key"], whole["flags"]) == ("apple", ["food_identified"])
    assert rows(IndexEntry) == []


def test_entry_comes_with_the_confirmation_follows_the_food_and_goes_with_both(meal_of, rows, state):
    meal = meal_of(identified_item(SURE, vcm=LOOKS))
    item_id = meal.items()[0]["id"]
    assert rows(IndexEntry) == []
    meal.say("confirm", item=item_id)
    confirmation = meal.history()["items"][-1]["id"]
    (entry,) = rows(IndexEntry)
    (seen,) = rows(ItemIdentification)
    (kept,) = rows(Meal)
    assert (str(entry.item_id), entry.run_id, entry.vcm_version) == (item_id, seen.run_id, VCM_VERSION)
    assert (entry.study_id, entry.participant_id) == (kept.study_id, kept.participant_id)
    assert (entry.food_key, entry.volume_ml, entry.captured_at) == ("apple", 185.0, kept.captured_at)
    assert entry.day_minute == 12 * 60 + 30  # by the clock on the wall in Shanghai
    meal.say("set_food", item=item_id, food="pear")
    meal.say("set_volume", item=item_id, volume_ml=120.0)
    assert [(one.food_key, one.volume_ml) for one in rows(IndexEntry)] == [("pear", 120.0)]
    meal.say("reject", item=item_id)
    assert rows(IndexEntry) == []
    for event in reversed(meal.history()["items"][1:]):
        meal.say("undo", event=event["id"])
    assert [one.food_key for one in rows(IndexEntry)] == ["apple"]
    meal.say("undo", event=confirmation)
    assert rows(IndexEntry) == []
    assert rebuild_records(state.database, write=False).different == 0


def test_confirmed_meal_teaches_all_its_items_and_a_hint_alone_nothing(meal_of, rows):
    meal = meal_of(identified_item(SURE), identified_item(UNSURE, hint=0), hints=[{"food": "pear"}])
    assert rows(IndexEntry) == []
    meal.say("confirm_meal")
    assert sorted(entry.food_key for entry in rows(IndexEntry)) == ["apple", "pear"]


def test_entry_of_a_redrawn_item_is_of_its_new_region_and_a_split_one_gives_way_to_its_measured_parts(
    meal_of, remeasure, rows
):
    meal = meal_of(identified_item(SURE))
    item_id = meal.items()[0]["id"]
    meal.say("confirm", item=item_id)
    (before,) = rows(IndexEntry)
    meal.say("redraw", item=item_id, polygon=RING)
    drawing = meal.history()["items"][-1]["id"]
    run_id = remeasure(meal, identified_item({"pear": 0.99}, volume_ml=90.0, hint=0))
    (entry,) = rows(IndexEntry)
    assert (entry.run_id, entry.food_key, entry.volume_ml) == (run_id, "apple", 90.0)
    meal.say("undo", event=drawing)
    assert [one.run_id for one in rows(IndexEntry)] == [before.run_id]
    meal.say("split", item=item_id, parts=[{"polygon": RING}, {"polygon": RING[::-1], "food": "pear"}])
    assert rows(IndexEntry) == []
    remeasure(meal, identified_item(SURE, hint=0), identified_item(UNSURE, hint=1))
    assert sorted(entry.food_key for entry in rows(IndexEntry)) == ["apple", "pear"]


def test_spoilt_entry_is_found_and_mended(meal_of, state, rows):
    meal = meal_of(identified_item(SURE), identified_item(UNSURE))
    meal.say("confirm", item=meal.items()[0]["id"])
    with state.database.write() as session:
        session.execute(sa.update(IndexEntry).values(food_key="pear"))
    assert rebuild_records(state.database, write=False).different == 1
    with state.database.write() as session:
        session.execute(sa.delete(IndexEntry))
    assert rebuild_records(state.database, write=False).different == 1
    assert rebuild_records(state.database, write=True).different == 1
    assert [entry.food_key for entry in rows(IndexEntry)] == ["apple"]
    with state.database.read() as session:
        changes = session.scalar(sa.select(sa.func.count(sa.distinct(EffectiveRecord.change_seq))))
    assert changes == 2  # the estimate's and the confirmation's: an entry is no change of a record


def by_model(probabilities):
    return {"model_candidates": [{"food": key, "probability": p} for key, p in probabilities.items()]}


def test_candidates_of_a_network_stand_after_those_of_the_index_and_assign_nothing(meal_of):
    meal = meal_of(identified_item(UNSURE, none=0.1, **by_model({"plum": 0.97, "no-such-food": 0.02, "apple": 0.01})))
    (item,) = meal.items()
    assert shown(item)[3:] == [("plum", 0.97, "model"), ("apple", 0.01, "model")]
    assert [source for _, _, source in shown(item)[:3]] == ["index"] * 3
    assert (item["food"], item["flags"], item["none_of_these"]) == (None, [], 0.1)
    meal.say("set_food", item=item["id"], food="plum")
    assert meal.items()[0]["food"]["key"] == "plum"


def test_candidates_of_a_network_follow_a_redrawn_region(meal_of, remeasure):
    meal = meal_of(identified_item(UNSURE, none=0.1, **by_model({"plum": 0.97})))
    (item,) = meal.items()
    meal.say("redraw", item=item["id"], polygon=RING)
    found = {"none": 0.05, "hint": 0, "index_version": "test 2"}
    remeasure(meal, identified_item({"peach": 0.7}, **found, **by_model({"pear": 0.6})))
    (after,) = meal.items()
    assert shown(after) == [("peach", 0.7, "index"), ("pear", 0.6, "model")]
    assert (after["none_of_these"], after["index_version"], after["food"]) == (0.05, "test 2", None)
    meal.say("redraw", item=item["id"], polygon=RING[::-1])
    remeasure(meal, identified_item({"apple": 0.6}, hint=0))  # the network failed: what it said before is gone
    assert shown(meal.items()[0]) == [("apple", 0.6, "index")]
    for event in meal.history()["items"][-2:]:
        meal.say("undo", event=event["id"])
    assert shown(meal.items()[0]) == shown(item)


def test_group_is_taken_for_an_item_where_no_food_is_likely_with_grams_and_energy_and_taught_to_nobody(meal_of, rows):
    found = identified_item({"orange": 0.5, "lemon": 0.4}, none=0.05)
    group = {"food": "citrus-fruit", "probability": 0.93, "specimens": 30, "is_group": True}
    meal = meal_of(found | {"candidates": [group, *found["candidates"]]})
    (item,) = meal.items()
    assert (item["food"]["key"], item["status"], item["flags"]) == ("citrus-fruit", "proposed", ["food_identified"])
    assert [each["food"]["key"] for each in item["candidates"]] == ["citrus-fruit", "orange", "lemon"]
    assert item["none_of_these"] == 0.05
    low, high = item["mass_interval_g"]
    assert low < item["mass_g"] < high
    meal.say("confirm", item=item["id"])
    assert meal.items()[0]["status"] == "confirmed"
    assert rows(IndexEntry) == []
    meal.say("set_food", item=item["id"], food="lemon")
    assert [entry.food_key for entry in rows(IndexEntry)] == ["lemon"]


def test_group_less_likely_than_asked_is_a_candidate_only_and_none_where_no_table_has_it(meal_of):
    found = identified_item({"orange": 0.5}, none=0.1)
    for key, shown in (("citrus-fruit", ["citrus-fruit", "orange"]), ("no-such-group", ["orange"])):
        group = {"food": key, "probability": 0.89, "specimens": 30, "is_group": True}
        (item,) = meal_of(found | {"candidates": [group, *found["candidates"]]}).items()
        assert item["food"] is None
        assert [each["food"]["key"] for each in item["candidates"]] == shown
        assert item["none_of_these"] == 0.1


def test_group_that_holds_the_hint_s_food_does_not_doubt_it(meal_of):
    group = {"food": "citrus-fruit", "probability": 0.99, "specimens": 30, "is_group": True}
    found = identified_item({"orange": 0.5, "lemon": 0.4}, hint=0)
    meal = meal_of(found | {"candidates": [group, *found["candidates"]]}, hints=[{"point": [3, 3], "food": "orange"}])
    (item,) = meal.items()
    assert (item["food"]["key"], item["flags"]) == ("orange", [])
