"""An amount that can hardly be is stored, flagged and waits for a reviewer; a strict caller is refused instead."""

import pytest

from tests.integration.records.eating import eaten
from tests.integration.records.reviewing import Speaker, new_event
from tests.support.estimates import found_item

APPLE = [{"point": [30, 20], "food": "apple"}]  # of which the pair shows 166 ml


@pytest.fixture
def meal_id(phone, state):
    return eaten(phone, state, found_item(166.0, hint=0), hints=APPLE)


@pytest.fixture
def participant(client, phone, meal_id):
    return Speaker(client, phone.headers, meal_id)


@pytest.fixture
def reviewer(client, admin, meal_id):
    return Speaker(client, admin, meal_id)


def item_of(meal):
    (item,) = meal["items"]
    return item


@pytest.mark.parametrize(
    ("event", "amount", "is_flagged"),
    [
        ("set_volume", {"volume_ml": 1505}, True),
        ("set_volume", {"volume_ml": 820}, False),
        ("set_volume", {"volume_ml": 30}, True),
        ("set_volume", {"volume_ml": 36}, False),
        ("set_mass", {"mass_g": 15000}, True),
        ("set_mass", {"mass_g": 400}, False),
        ("set_mass", {"mass_g": 20}, True),
        ("set_mass", {"portion": "NLEA serving", "count": 40}, True),
    ],
)
def test_amount_that_can_hardly_be_is_flagged_and_waits_for_a_review(participant, event, amount, is_flagged):
    item = item_of(participant.meal())
    meal = participant.say(event, item=item["id"], **amount)
    item = item_of(meal)
    assert ("implausible_amount" in item["flags"]) is is_flagged
    assert (item["status"], meal["status"]) == (("needs_review",) * 2 if is_flagged else ("corrected", "confirmed"))


def test_participants_confirmation_does_not_settle_it_and_a_reviewers_does(participant, reviewer):
    item = item_of(participant.meal())["id"]
    participant.say("set_mass", item=item, mass_g=15000)
    assert participant.say("confirm", item=item)["status"] == "needs_review"
    meal = reviewer.say("confirm", item=item)
    assert (meal["status"], item_of(meal)["mass_g"]) == ("confirmed", 15000)
    assert "implausible_amount" in item_of(meal)["flags"]


def test_strict_event_is_refused_and_changes_nothing_and_the_same_without_it_is_stored(participant):
    before = participant.meal()
    event = new_event("set_mass", item=item_of(before)["id"], mass_g=15000)
    answer = participant.send(event | {"strict": True})
    assert (answer.status_code, answer.json()["code"]) == (422, "implausible_amount")
    assert participant.meal() == before
    assert participant.send(event).status_code == 201
    assert participant.send(event | {"strict": True}).status_code == 200  # it is there already
    comment = participant.send(new_event("comment", text="yes, all of it") | {"strict": True})
    assert comment.status_code == 201
