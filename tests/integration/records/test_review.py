"""What people say of a meal and what follows from it, over HTTP on both databases."""

import uuid

import pytest
import sqlalchemy as sa

from app.outbox.models import Webhook, WebhookDelivery
from app.people.models import Study
from app.records.recompute_records import rebuild_records
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.records.reviewing import Speaker, new_event
from tests.support import estimates
from tests.support.estimates import found_item, unmeasured_item
from tests.support.photographs import pair

HINTS = [{"point": [30, 20], "food": "apple"}, {"point": [60, 20], "food": "milk-whole"}, {"point": [90, 20]}]


@pytest.fixture
def body(phone, state):
    """A meal of an apple, milk whose volume is not known, and something that nobody has named."""
    body = meal_metadata(hints=HINTS)
    assert phone.post(pair(), body).status_code == 202
    estimates.save(state, body["id"], found_item(hint=0), unmeasured_item(hint=1), found_item(100.0, hint=2))
    return body


@pytest.fixture
def participant(phone, client, body):
    return Speaker(client, phone.headers, body["id"])


@pytest.fixture
def reviewer(client, admin, body):
    return Speaker(client, admin, body["id"])


@pytest.fixture(autouse=True)
def _records_follow_from_events(request):
    """Whatever a test has said, the records are those that would be built from nothing."""
    state = request.getfixturevalue("state")
    yield
    assert rebuild_records(state.database, write=False).different == 0


def statuses(meal):
    return [item["status"] for item in meal["items"]]


def test_meal_is_confirmed_once_each_item_has_a_food_and_an_amount(participant):
    before = participant.meal()
    apple, milk, unnamed = (item["id"] for item in before["items"])
    meal = participant.say("confirm", item=apple)
    assert statuses(meal) == ["confirmed", "needs_review", "needs_review"]
    assert meal["version"] == before["version"] + 1
    assert not meal["items"][0]["reviewed"]
    for item in (milk, unnamed):
        assert participant.refused("confirm", item=item) == (409, "item_incomplete")
    assert participant.refused("confirm_meal") == (409, "item_incomplete")
    participant.say("set_volume", item=milk, volume_ml=200)
    participant.say("reject", item=unnamed)
    meal = participant.say("confirm_meal")
    assert (meal["status"], statuses(meal)) == ("confirmed", ["confirmed", "corrected", "rejected"])
    assert meal["totals"]["unmeasured_items"] == 0


def test_event_needs_the_current_version_unless_it_is_the_same_again(participant, client):
    event = new_event("confirm", item=participant.items()[0]["id"])
    path = f"/v1/meals/{participant.meal_id}/events"
    assert client.post(path, headers=participant.headers, json=event).status_code == 428
    version = participant.meal()["version"]
    answer = participant.send(event, if_match=f'"{version - 1}"')
    assert (*refusal(answer), answer.json()["version"]) == (412, "precondition_failed", version)
    first = participant.send(event)
    again = participant.send(event, if_match='"0"')  # the phone did not hear the answer
    assert (first.status_code, again.status_code) == (201, 200)
    assert (again.json(), again.headers["etag"]) == (first.json(), first.headers["etag"])
    assert refusal(participant.send(event | {"kind": "reject"})) == (409, "event_id_reused")


def test_set_food_weighs_the_item_anew_and_set_share_scales_what_was_consumed(participant):
    apple = participant.items()[0]
    shared = participant.say("set_share", item=apple["id"], share=0.25)["items"][0]
    assert shared["consumed_g"] == pytest.approx(0.25 * apple["consumed_g"])
    assert (shared["edible_g"], shared["status"]) == (apple["edible_g"], "proposed")
    changed = participant.say("set_food", item=apple["id"], food="banana")["items"][0]
    assert (changed["food"]["key"], changed["status"]) == ("banana", "corrected")
    assert changed["volume_ml"] == apple["volume_ml"]
    assert changed["mass_g"] == pytest.approx(apple["volume_ml"] * changed["density_g_per_ml"])
    assert participant.refused("set_food", item=apple["id"], food="no-such-food") == (422, "food_unknown")
    added = participant.say("add", food="bread-white", amount={"mass_g": 40})["items"][-1]
    assert (added["origin"], added["status"], added["mass_g"]) == ("added", "confirmed", pytest.approx(40))


def test_grams_and_household_measures_are_set_by_hand_and_density_is_shown_only_where_grams_follow_from_it(participant):
    apple, milk, _ = participant.items()
    shown = ("density_g_per_ml", "density_sd_g_per_ml", "density_basis", "density_source")
    assert None not in [apple[name] for name in shown]
    weighed = participant.say("set_mass", item=apple["id"], mass_g=150, of="edible", relative_sd=0.02)["items"][0]
    assert weighed["edible_g"] == pytest.approx(150)
    assert weighed["mass_g"] == pytest.approx(150 / weighed["edible_share"])
    assert weighed["volume_ml"] == apple["volume_ml"]
    assert [weighed[name] for name in shown] == [None] * 4
    records = participant.client.get("/v1/records", headers=participant.headers).json()["items"]
    record = next(record for record in records if record["id"] == apple["id"])
    assert (record["density_g_per_ml"], record["density_source"]) == (None, None)
    assert record["volume_ml"] == apple["volume_ml"]
    measured = participant.say("set_volume", item=apple["id"], volume_ml=200)["items"][0]
    assert [measured[name] for name in shown] == [apple[name] for name in shown]
    portion = participant.client.get("/v1/foods/milk-whole", headers=participant.headers).json()["portions"][0]
    meal = participant.say("set_mass", item=milk["id"], portion=portion["measure"], count=1.5)
    assert meal["items"][1]["edible_g"] == pytest.approx(1.5 * portion["mass_g"] / portion["amount"])
    assert participant.refused("set_mass", item=milk["id"], portion="a barrel", count=1) == (422, "portion_unknown")


def test_parts_of_a_portion_are_portions_of_the_same_food(participant):
    apple = participant.items()[0]
    portion = participant.client.get("/v1/foods/apple", headers=participant.headers).json()["portions"][0]
    whole = participant.say("set_mass", item=apple["id"], portion=portion["measure"], count=2)["items"][0]
    event = new_event("set_food", item=apple["id"], food="banana")
    changed = participant.send(event).json()["items"][0]  # of which it is no portion
    assert changed["volume_ml"] == apple["volume_ml"]
    assert changed["mass_g"] == pytest.approx(apple["volume_ml"] * changed["density_g_per_ml"])
    assert participant.say("undo", event=event["id"])["items"][0] == whole
    parts = [{"share": 0.5}, {"share": 0.5, "food": "banana"}]
    same, other = participant.say("split", item=apple["id"], parts=parts)["items"][-2:]
    assert same["edible_g"] == pytest.approx(whole["edible_g"] / 2)
    assert other["volume_ml"] == pytest.approx(apple["volume_ml"] / 2)
    assert other["mass_g"] == pytest.approx(other["volume_ml"] * other["density_g_per_ml"])


def test_undo_restores_what_was_and_is_done_once_and_not_of_a_higher_layer(participant, reviewer):
    before = participant.items()[0]
    event = new_event("set_food", item=before["id"], food="banana")
    assert participant.send(event).status_code == 201
    assert participant.say("undo", event=event["id"])["items"][0] == before
    assert participant.refused("undo", event=event["id"]) == (409, "event_undone")
    theirs = new_event("set_food", item=before["id"], food="pear")
    own = new_event("set_share", item=before["id"], share=0.5)
    reviewer.send(theirs)
    participant.send(own)
    assert participant.refused("undo", event=theirs["id"]) == (403, "event_not_yours")
    assert reviewer.say("undo", event=own["id"])["items"][0]["share"] == 1.0


def test_split_by_shares_gives_parts_that_sum_to_the_whole_and_undo_restores_it(participant):
    apple = participant.items()[0]
    event = new_event("split", item=apple["id"], parts=[{"share": 0.25}, {"share": 0.75, "food": "pear"}])
    assert participant.send(event).status_code == 201
    parts = [item for item in participant.items() if item["origin"] == "split"]
    assert [part["food"]["key"] for part in parts] == ["apple", "pear"]
    assert [part["volume_ml"] for part in parts] == pytest.approx([0.25 * 185, 0.75 * 185])
    assert participant.refused("confirm", item=apple["id"]) == (409, "item_replaced")
    meal = participant.say("undo", event=event["id"])
    assert meal["items"][0] == apple
    assert participant.refused("confirm", item=parts[0]["id"]) == (409, "item_replaced")


def test_merged_items_are_one_with_the_amount_of_both_and_different_foods_need_a_name(participant):
    apple, milk, unnamed = participant.items()
    meal = participant.say("merge", items=[apple["id"], unnamed["id"]])
    merged = next(item for item in meal["items"] if item["origin"] == "merged")
    assert (merged["food"]["key"], merged["volume_ml"]) == ("apple", pytest.approx(285.0))
    assert len(participant.items()) == 2
    both = [merged["id"], milk["id"]]
    assert participant.refused("merge", items=both) == (422, "merge_needs_food")
    merged = participant.say("merge", items=both, food="fruit-salad")["items"][-1]
    assert (merged["food"]["key"], merged["volume_ml"], merged["status"]) == ("fruit-salad", None, "needs_review")


def test_redrawn_outline_is_measured_by_a_run_of_its_own(participant, state):
    apple = participant.items()[0]
    ring = [[5.0, 5.0], [80.0, 5.0], [80.0, 80.0]]
    meal = participant.say("redraw", item=apple["id"], polygon=ring)
    redrawn = meal["items"][0]
    assert (redrawn["flags"], redrawn["volume_ml"], redrawn["polygon"]) == (["remeasuring"], 185.0, [ring])
    assert participant.refused("confirm", item=apple["id"]) == (409, "item_remeasuring")
    measured = found_item(220.0, polygon=ring)
    estimates.save(state, participant.meal_id, measured, purpose="remeasure", regions=[apple["id"]])
    measured = participant.items()[0]
    assert (measured["flags"], measured["volume_ml"], measured["status"]) == ([], 220.0, "corrected")
    assert participant.meal()["run"] == meal["run"]


def test_outline_that_encloses_nothing_or_too_much_is_refused(participant):
    apple = participant.items()[0]
    for polygon in (
        [],
        [[[1, 1], [2, 2]]],
        [[[1, 1], [2, 2], [3, 1]], []],
        [[[1, 1], [2, 2], [3, "1"]]],
        [[[x, x % 7] for x in range(6000)], [[x, x % 5] for x in range(6000)]],
        [[[[1, 1], [2, 2], [3, 1]]]],
        {"0": [[1, 1]]},
    ):
        assert participant.refused("redraw", item=apple["id"], polygon=polygon) == (422, "invalid_input")


def test_answered_probe_is_an_item_of_its_own_or_names_the_food_and_is_not_asked_again(participant):
    added = participant.say("add", food="potatoes-boiled", amount={"mass_g": 200})["items"][-1]
    assert "fat_added" in added["open_probes"]
    told = {"item": added["id"], "probe": "fat_added"}
    assert participant.refused("declare", **told, answer="yes") == (422, "declared_food_missing")
    meal = participant.say("declare", **told, answer="yes", food="butter", amount={"mass_g": 10})
    butter = meal["items"][-1]
    assert (butter["origin"], butter["parent"], butter["mass_g"]) == ("declared", added["id"], pytest.approx(10))
    assert "fat_added" not in meal["items"][-2]["open_probes"]
    assert participant.refused("declare", **told, answer="no") == (409, "probe_answered")
    assert participant.refused("declare", item=added["id"], probe="drained", answer="no") == (422, "probe_unknown")
    meal = participant.say("reject", item=added["id"])
    assert meal["items"][-1]["status"] == "rejected"
    other = participant.say("add", food="potatoes-boiled", amount={"mass_g": 200})["items"][-1]
    meal = participant.say("declare", item=other["id"], probe="fat_added", answer="unknown")
    assert "fat_added" not in meal["items"][-1]["open_probes"]
    canned = participant.say("add", food="peaches-canned", amount={"mass_g": 120})["items"][-1]
    after = participant.say("declare", item=canned["id"], probe="drained", answer="no", food="peach")["items"]
    assert (len(after), after[-1]["food"]["key"]) == (len(meal["items"]) + 1, "peach")
    assert "drained" not in after[-1]["open_probes"]


def test_what_was_declared_of_a_shared_dish_is_shared_as_the_dish_is(participant):
    for order in ("declared_then_shared", "shared_then_declared"):
        declare_and_share(participant, order)


def declare_and_share(participant, order):
    dish = participant.say("add", food="potatoes-boiled", amount={"mass_g": 200})["items"][-1]["id"]
    own = participant.say("add", food="potatoes-boiled", amount={"mass_g": 200})["items"][-1]["id"]
    butter = {"probe": "fat_added", "answer": "yes", "food": "butter", "amount": {"mass_g": 20}}
    if order == "declared_then_shared":
        participant.say("declare", item=dish, **butter)
        participant.say("declare", item=own, **butter, share=0.25)
    for item in (dish, own):
        participant.say("set_share", item=item, share=0.5)
    if order == "shared_then_declared":
        participant.say("declare", item=dish, **butter)
        participant.say("declare", item=own, **butter, share=0.25)
    of_dish, of_own = participant.items()[-2:]
    assert (of_dish["share"], of_dish["consumed_g"]) == (0.5, pytest.approx(10.0))
    assert (of_own["share"], of_own["consumed_g"]) == (0.25, pytest.approx(5.0))
    meal = participant.say("set_share", item=of_dish["id"], share=1.0)
    assert meal["items"][-2]["consumed_g"] == pytest.approx(20.0)


def test_history_tells_staff_names_and_participants_only_layers_in_pages(participant, reviewer):
    apple = participant.items()[0]["id"]
    participant.say("set_food", item=apple, food="banana")
    reviewer.say("comment", item=apple, text="Looks like a plantain.")
    rows = participant.history()["items"]
    assert [row["author"] for row in rows] == ["participant", "reviewer"]
    assert rows[0]["old"] == {"food": "apple", "lies_as": None}
    assert rows[0]["new"] == {"food": "banana", "lies_as": None}
    assert [row["author"] for row in reviewer.history()["items"]] == ["P001", "admin"]
    participant.say("comment", text="It was fried.")
    first = participant.history(limit=2)
    second = participant.client.get(first["next"], headers=participant.headers).json()
    assert [row["sequence"] for row in first["items"] + second["items"]] == [1, 2, 3]
    assert second["next"] is None


def test_meal_that_is_not_estimated_yet_takes_no_corrections_and_none_an_item_of_another(participant, phone, state):
    body = meal_metadata(hints=HINTS)
    phone.post(pair(), body)
    speaker = Speaker(phone.client, phone.headers, body["id"])
    assert speaker.refused("confirm_meal") == (409, "meal_not_estimated")
    assert speaker.say("comment", text="It was my birthday.")["status"] == "queued"
    estimates.save(state, body["id"], found_item())
    assert participant.refused("confirm", item=speaker.items()[0]["id"]) == (404, "item_not_found")


def test_participant_does_not_split_what_a_reviewer_has_spoken_of(participant, reviewer):
    apple, _, unnamed = participant.items()
    reviewer.say("confirm", item=apple["id"])
    parts = [{"share": 0.5}, {"share": 0.5}]
    assert participant.refused("split", item=apple["id"], parts=parts) == (409, "item_reviewed")
    assert participant.refused("merge", items=[apple["id"], unnamed["id"]]) == (409, "item_reviewed")
    event = new_event("split", item=unnamed["id"], parts=parts)
    participant.send(event)
    part = participant.items()[-1]
    reviewer.say("set_food", item=part["id"], food="pear")
    assert participant.refused("undo", event=event["id"]) == (409, "item_reviewed")
    assert reviewer.say("undo", event=event["id"])["items"][2]["status"] == "needs_review"


def test_meal_that_failed_can_be_told_in_words(phone, client, state):
    body = meal_metadata(hints=HINTS)
    phone.post(pair(), body)
    failure = {"code": "marker_not_found", "message": "No board.", "advice": "Show it."}
    estimates.save(state, body["id"], failure=failure)
    speaker = Speaker(client, phone.headers, body["id"])
    event = new_event("add", food="apple", amount={"mass_g": 150})
    assert speaker.send(event).json()["status"] == "confirmed"
    assert speaker.say("undo", event=event["id"])["status"] == "failed"
    assert speaker.say("confirm_meal")["status"] == "confirmed"


def test_event_that_makes_no_sense_is_invalid(participant):
    item = participant.items()[0]["id"]
    for fields in (
        {"kind": "set_mass", "mass_g": 100, "portion": "cup", "count": 1},
        {"kind": "set_mass", "portion": "cup"},
        {"kind": "set_mass", "mass_g": 0},
        {"kind": "set_volume", "volume_ml": 1e300},
        {"kind": "set_share", "share": 1.01},
        {"kind": "set_share", "share": 0},
        {"kind": "split", "parts": [{"share": 0.5}, {"share": 0.6}]},
        {"kind": "split", "parts": [{"share": 0.5}, {"food": "apple"}]},
        {"kind": "redraw", "polygon": [[0, 0], [1, 1]]},
        {"kind": "confirm", "status": "confirmed"},
        {"kind": "declare", "probe": "fat_added", "answer": "unknown", "food": "butter"},
        {"kind": "eat"},
    ):
        answer = participant.send(new_event(fields["kind"], item=item) | fields)
        assert refusal(answer) == (422, "invalid_input"), fields
    assert participant.history()["items"] == []


def test_confirmed_meal_is_told_to_webhooks_once(participant, state):
    with state.database.write() as session:
        study = session.scalars(sa.select(Study)).one()
        hook = Webhook(id=uuid.uuid4(), study_id=study.id, url="https://example.org", events=["meal.confirmed"])
        hook.secret_sealed, hook.author, hook.created_at = "", "admin", study.created_at
        session.add(hook)
    _, milk, unnamed = participant.items()
    for item in (milk, unnamed):
        participant.say("reject", item=item["id"])
    participant.say("confirm_meal")
    participant.say("comment", text="Good.")
    with state.database.read() as session:
        told = [row.event for row in session.scalars(sa.select(WebhookDelivery))]
    assert told == ["meal.confirmed"]
