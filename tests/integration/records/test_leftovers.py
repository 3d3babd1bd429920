"""What was left becomes what was eaten: matching, refuse, windows, people's words, both orders of the two runs."""

import functools
import uuid
from datetime import UTC, datetime, timedelta

import pytest

from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Leftover
from app.meals.upload.after_meal import end_due_windows
from app.records.recompute_records import rebuild_records
from tests.integration.records.after_pairs import (
    HINTS,
    RED,
    WHITE,
    Table,
    apple,
    banana,
    left_of_apple,
    left_of_banana,
)
from tests.integration.records.at_once import at_once
from tests.integration.records.reviewing import Speaker
from tests.support.estimates import seen_item, unmeasured_item

NO_FOOD = {"code": "no_food_found", "message": "Nothing stands out.", "advice": "Mark it."}
FAILURE = {"code": "marker_not_found", "message": "No board.", "advice": "Put it beside the plate."}


@pytest.fixture
def table(phone, state):
    return Table(phone, state)


@pytest.fixture
def participant(phone, table):
    return Speaker(phone.client, phone.headers, table.id)


@pytest.fixture
def reviewer(client, admin, table):
    return Speaker(client, admin, table.id)


@pytest.fixture(autouse=True)
def records_can_be_rebuilt(state):
    """After each test: what stands there is what runs and events amount to."""
    yield
    assert rebuild_records(state.database, write=False).different == 0


def leftover(table, place=0):
    return table.after["leftovers"][place]


def test_eaten_is_served_less_left_in_edible_grams_of_each_item(table):
    meal = table.ate(left_of_banana(140.0), left_of_apple(100.0)).get()
    of = {item["id"]: item["food"]["key"] for item in meal["items"]}
    assert [of[each["item"]] for each in meal["after"]["leftovers"]] == ["banana", "apple"]
    one = meal["items"][0]
    left = next(each for each in meal["after"]["leftovers"] if each["item"] == one["id"])
    assert (left["class"], left["food"]["key"], left["is_by_person"]) == ("food_left", "apple", False)
    assert left["mass_g"] == pytest.approx(100.0 * one["density_g_per_ml"])
    assert one["left_g"] == pytest.approx(left["mass_g"] * one["edible_share"])
    assert one["consumed_g"] == pytest.approx(one["edible_g"] - one["left_g"])
    assert one["consumed_interval_g"][0] < one["consumed_g"] < one["consumed_interval_g"][1]
    energy = next(n for n in one["nutrients"] if n["number"] == "208")
    assert energy["amount"] == pytest.approx(0.52 * one["consumed_g"])


def test_empty_plate_is_an_answer_and_nothing_found_where_the_phone_pointed_is_a_failure(table, state):
    table.ate(failure=NO_FOOD)
    assert (table.after["status"], table.after["failure"], table.after["leftovers"]) == ("estimated", None, [])
    assert table.record("apple")["left_g"] == 0.0
    pointed = Table(table.phone, state, seed=1)
    pointed.tell(hints=[{"point": [3, 4], "class": "food_left"}])
    assert pointed.ate(failure=NO_FOOD).after["failure"]["code"] == "no_food_found"


@pytest.mark.parametrize("after_first", [False, True])
def test_pieces_are_matched_whichever_run_ends_first(table, after_first):
    table.send_after()
    if after_first:
        table.after_measured(left_of_apple(100.0))
        assert (table.after["status"], leftover(table)["class"]) == ("needs_review", "unmatched")
        table.measured()
    else:
        table.measured().after_measured(left_of_apple(100.0))
    assert (table.after["status"], leftover(table)["class"]) == ("estimated", "food_left")
    assert table.record("apple")["left_g"] > 0


def test_runs_that_end_at_the_same_time_leave_no_piece_unmatched(phone, state):
    for seed in range(5):
        table = Table(phone, state, seed=seed).send_after()
        at_once(table.measured, functools.partial(table.after_measured, left_of_apple(100.0)))
        assert (table.after["status"], leftover(table)["class"]) == ("estimated", "food_left")


def test_signed_difference_is_kept_where_more_is_left_than_was_served(table):
    table.ate(left_of_apple(190.0))
    record = table.record("apple")
    assert -10.0 < record["consumed_g"] < 0.0
    assert record["energy_kcal"] < 0.0
    assert record["consumed_low_g"] < record["consumed_g"] < record["consumed_high_g"]


def test_core_of_an_apple_is_refuse_assumed_and_not_taken_off_again(table):
    table.ate(left_of_apple(15.0))
    assert leftover(table)["class"] == "refuse"
    assert "refuse_assumed" in table.record("apple")["flags"]
    for food in ("apple", "banana"):  # of which nothing is left
        record = table.record(food)
        assert (record["left_g"], record["consumed_g"], record["provisional"]) == (0.0, record["edible_g"], False)


def test_hint_tells_item_and_class(table):
    table.measured()
    items = {item["food"]["key"]: item["id"] for item in table.get()["items"]}
    table.tell(hints=[{"point": [3, 4], "item": items["banana"], "class": "refuse"}])
    table.send_after().after_measured(left_of_apple(90.0, hint=0))  # it looks like the apple, and lies there
    assert (leftover(table)["item"], leftover(table)["class"]) == (items["banana"], "refuse")
    assert table.record("banana")["flags"] == []
    assert table.record("apple")["left_g"] == 0.0


def test_food_that_the_phone_names_tells_whose_piece_it_is_and_an_unknown_item_is_passed_over(table, state):
    table.tell(hints=[{"point": [3, 4], "food": "banana", "class": "food_left"}])
    table.ate(seen_item(10, 200, WHITE, 60.0, hint=0))
    assert leftover(table)["food"]["key"] == "banana"
    assert [item["food"]["key"] for item in table.get()["items"]] == [hint["food"] for hint in HINTS]
    other = Table(table.phone, state, seed=1)
    other.tell(hints=[{"point": [3, 4], "item": str(uuid.uuid4())}])
    assert leftover(other.ate(left_of_apple(90.0, hint=0)))["food"]["key"] == "apple"


def test_piece_that_is_nobodys_is_flagged_on_every_item_until_a_reviewer_says_so(table, reviewer):
    table.ate(seen_item(300, -200, (60.0, 5.0, -45.0), 60.0))
    assert (leftover(table)["class"], leftover(table)["item"]) == ("unmatched", None)
    assert table.after["status"] == "needs_review"
    for food in ("apple", "banana"):
        assert "leftover_unmatched" in table.record(food)["flags"]
        assert table.record(food)["consumed_g"] == table.record(food)["edible_g"]
    reviewer.say("set_leftover", item=leftover(table)["id"], of=None, **{"class": "unmatched"})
    assert table.after["status"] == "estimated"
    assert "leftover_unmatched" not in table.record("apple")["flags"]


def test_piece_whose_amount_is_unknown_leaves_what_was_eaten_unknown_until_a_person_weighs_it(table, reviewer):
    table.ate(unmeasured_item(hint=None) | {"traits": left_of_apple()["traits"]})
    record = table.record("apple")
    assert (record["left_g"], record["consumed_g"], record["energy_kcal"]) == (None, None, None)
    assert record["status"] == "needs_review"
    assert "leftover_not_measurable" in record["flags"]
    said = reviewer.say("set_mass", item=leftover(table)["id"], mass_g=60.0)
    assert said["after"]["leftovers"][0]["mass_g"] == 60.0
    assert said["after"]["status"] == "estimated"
    record = table.record("apple")
    assert record["left_g"] == pytest.approx(60.0 * said["items"][0]["edible_share"])
    assert record["consumed_g"] == pytest.approx(record["edible_g"] - record["left_g"])


def test_person_says_of_which_item_a_piece_is_and_takes_it_back_and_a_reviewer_goes_over_it(
    table, participant, reviewer
):
    meal = table.ate(left_of_apple(100.0)).get()
    items = {item["food"]["key"]: item["id"] for item in meal["items"]}
    piece = leftover(table)["id"]
    said = participant.say("set_leftover", item=piece, of=items["banana"], **{"class": "food_left"})
    (now,) = said["after"]["leftovers"]
    assert (now["item"], now["is_by_person"], now["food"]["key"]) == (items["banana"], True, "banana")
    assert (table.record("apple")["left_g"], table.record("banana")["left_g"] > 0) == (0.0, True)
    event = participant.history()["items"][-1]
    assert event["old"] == {"of": items["apple"], "class": "food_left"}
    assert event["new"] == {"of": items["banana"], "class": "food_left"}
    participant.say("undo", event=event["id"])
    assert leftover(table)["item"] == items["apple"]
    reviewer.say("set_leftover", item=piece, of=items["apple"], **{"class": "refuse"})
    participant.say("set_leftover", item=piece, of=items["banana"], **{"class": "food_left"})
    assert (leftover(table)["item"], leftover(table)["class"]) == (items["apple"], "refuse")


def test_words_on_pieces_that_cannot_be_are_refused(table, reviewer):
    meal = table.ate(left_of_apple(100.0)).get()
    item, piece = meal["items"][0]["id"], leftover(table)["id"]
    assert reviewer.refused("set_leftover", item=piece, of=None, **{"class": "refuse"})[0] == 422
    assert reviewer.refused("set_leftover", item=piece, of=item, **{"class": "unmatched"})[0] == 422
    assert reviewer.refused("set_leftover", item=item, of=item, **{"class": "refuse"}) == (404, "leftover_not_found")
    other = str(uuid.uuid4())
    assert reviewer.refused("set_leftover", item=piece, of=other, **{"class": "refuse"}) == (404, "item_not_found")
    reviewer.say("reject", item=item)
    assert reviewer.refused("set_leftover", item=piece, of=item, **{"class": "refuse"}) == (409, "item_rejected")


def test_piece_of_a_rejected_item_is_matched_anew(table, reviewer):
    meal = table.ate(seen_item(-58, 104, RED, 60.0)).get()
    assert leftover(table)["item"] == meal["items"][0]["id"]
    reviewer.say("reject", item=meal["items"][0]["id"])
    assert leftover(table)["item"] != meal["items"][0]["id"]


def test_another_food_changes_what_is_refuse_by_a_new_match(table, reviewer, state):
    meal = table.ate(left_of_apple(60.0)).get()
    assert leftover(table)["class"] == "food_left"
    reviewer.say("set_food", item=meal["items"][0]["id"], food="pomelo")  # 44 % of it are skin and seeds
    assert (leftover(table)["class"], leftover(table)["food"]["key"]) == ("refuse", "pomelo")
    reviewer.say("confirm", item=meal["items"][0]["id"])
    with state.database.read() as session:
        rows = session.query(Leftover).order_by(Leftover.version).all()
        assert [(row.version, row.leftover_class, row.layer) for row in rows] == [
            (1, "food_left", "automatic"),
            (2, "refuse", "automatic"),
        ]


def test_nothing_left_by_word_ends_the_wait_and_can_be_taken_back(enrol, state, client):
    phone = enrol("P007", "waits", expects_after_pair=True)
    table = Table(phone, state).measured()
    speaker = Speaker(client, phone.headers, table.id)
    assert table.record("apple")["provisional"]
    said = speaker.say("nothing_left")
    assert said["after"]["status"] == "nothing_left"
    record = table.record("apple")
    assert (record["provisional"], record["left_g"], record["consumed_g"]) == (False, 0.0, record["edible_g"])
    speaker.say("undo", event=speaker.history()["items"][-1]["id"])
    assert (table.after["status"], table.record("apple")["provisional"]) == (None, True)
    assert table.record("apple")["left_g"] is None


def test_what_no_camera_saw_nobody_has_looked_for_after_the_meal(table, participant):
    table.ate(left_of_apple())
    dish = participant.say("add", food="potatoes-boiled", amount={"mass_g": 200})["items"][-1]["id"]
    told = {"item": dish, "probe": "fat_added", "answer": "yes", "food": "butter", "amount": {"mass_g": 10}}
    butter = participant.say("declare", **told)["items"][-1]
    assert (butter["left_g"], butter["consumed_g"]) == (None, pytest.approx(10.0))
    piece = leftover(table)["id"]
    said = participant.say("set_leftover", item=piece, of=butter["id"], **{"class": "food_left"})
    assert said["items"][-1]["left_g"] > 0.0  # but what a person says is left of it is


def test_nothing_left_may_be_said_before_any_pair_is_measured_and_a_pair_says_more(table, participant):
    participant.say("nothing_left")
    table.measured()
    record = table.record("apple")
    assert (table.after["status"], record["left_g"], record["provisional"]) == ("nothing_left", 0.0, False)
    table.send_after().after_measured(left_of_apple(100.0))
    record = table.record("apple")
    assert (table.after["status"], record["left_g"] > 0, record["provisional"]) == ("estimated", True, False)
    assert participant.refused("nothing_left") == (409, "after_pair_measured")


def test_nothing_left_settles_a_failed_pair(table, participant):
    table.measured().send_after().after_measured(failure=FAILURE)
    participant.say("nothing_left")
    assert table.after["status"] == "nothing_left"
    assert (table.record("apple")["left_g"], table.record("apple")["flags"]) == (0.0, [])
    participant.say("undo", event=participant.history()["items"][-1]["id"])
    assert table.after["status"] == "failed"


@pytest.fixture
def waiting(enrol, state):
    """A meal of a study that expects an after-meal pair within four hours."""
    now = datetime.now(UTC)
    return Table(
        enrol("P003", "expects", expects_after_pair=True),
        state,
        captured_at=(now - timedelta(minutes=5)).isoformat(),
        time_zone="UTC",
    ).measured()


def close_windows_in(state, **after):
    """As the chore does that much later."""
    with state.database.write() as session:
        for meal in session.query(Meal).filter(Meal.after_due_at.is_not(None)):
            meal.after_due_at -= timedelta(**after)
    return end_due_windows(state.database)


def change_seqs(state):
    with state.database.read() as session:
        return sorted(row.change_seq for row in session.query(EffectiveRecord))


def test_window_ends_and_the_records_are_counted_as_changed_and_a_late_pair_is_still_taken(waiting, state):
    assert close_windows_in(state, hours=1) == 0
    before = change_seqs(state)
    assert close_windows_in(state, hours=4) == 1
    assert waiting.record("apple")["provisional"] is False
    assert waiting.after is None
    assert min(change_seqs(state)) > max(before)
    assert end_due_windows(state.database) == 0
    before = change_seqs(state)
    waiting.send_after().after_measured(left_of_apple(100.0))
    assert waiting.record("apple")["left_g"] > 0
    assert max(change_seqs(state)) > max(before)


def test_failed_pair_ends_the_wait_until_another_is_sent_and_the_window_ends_over_half_of_it(waiting, state):
    waiting.send_after().after_measured(failure=FAILURE)
    assert not waiting.record("apple")["provisional"]
    waiting.put("after_left", seed=91)
    assert waiting.record("apple")["provisional"]
    assert close_windows_in(state, hours=9) == 1
    assert not waiting.record("apple")["provisional"]


def test_windows_end_in_bounded_batches(enrol, state, monkeypatch):
    phone = enrol("P004", "many", expects_after_pair=True)
    for seed in range(3):
        Table(phone, state, seed=seed).measured()
    monkeypatch.setattr("app.meals.upload.after_meal.BATCH", 2)
    assert [end_due_windows(state.database) for _ in range(3)] == [2, 1, 0]


def test_leftovers_of_a_meal_whose_food_is_not_known_are_matched_all_the_same(table):
    table.measured(apple(hint=None), banana()).send_after().after_measured(left_of_apple(100.0))
    meal = table.get()
    assert leftover(table)["item"] == meal["items"][0]["id"]
    assert (leftover(table)["mass_g"], meal["items"][0]["consumed_g"]) == (None, None)
