"""The reviewers' queue and the participant's open questions."""

import json

import pytest

from tests.integration.conftest import meal_metadata
from tests.integration.records.eating import eaten
from tests.integration.records.reviewing import Speaker, new_event
from tests.support.estimates import found_item, unmeasured_item

QUEUE = "/v1/studies/pilot/review-queue"


@pytest.fixture
def queue(client, admin):
    def queue(**params):
        answer = client.get(QUEUE, headers=admin, params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    return queue


@pytest.fixture
def meal_of(state):
    """An estimated meal of a phone, from a list of its items."""
    return lambda phone, *items: eaten(phone, state, *items)


def doubtful(relative_sd, **changes):
    return found_item(relative_sd={"pair": 0.0, "item": relative_sd}, **changes)


def test_most_doubtful_item_comes_first_with_all_that_a_decision_needs(queue, phone, meal_of, client, admin):
    meal_of(phone, doubtful(0.05))
    wide = meal_of(phone, doubtful(0.4))
    unknown = meal_of(phone, unmeasured_item())
    rows = queue()["items"]
    assert [row["meal"] for row in rows][:2] == [unknown, wide]
    assert [row["doubt"] for row in rows] == sorted((row["doubt"] for row in rows), reverse=True)
    assert rows[0]["doubt"] == 1.0
    row = rows[1]
    assert (row["food"]["key"], row["candidates"][0]["food"]["key"], row["participant"]) == ("apple", "apple", "P001")
    assert client.get(row["meal_href"], headers=admin).headers["etag"] == row["etag"]
    assert client.get(row["photograph_href"], headers=admin).status_code == 200


def test_reviewed_and_rejected_items_leave_the_queue(queue, phone, meal_of, client, admin):
    for word, headers in (("confirm", admin), ("reject", phone.headers)):
        speaker = Speaker(client, headers, meal_of(phone, found_item()))
        speaker.say(word, item=speaker.items()[0]["id"])
    kept = Speaker(client, phone.headers, meal_of(phone, found_item()))
    kept.say("confirm", item=kept.items()[0]["id"])
    assert [row["meal"] for row in queue()["items"]] == [kept.meal_id]


def test_item_stays_in_the_queue_until_food_and_amount_are_known(queue, phone, meal_of, client, admin):
    speaker = Speaker(client, admin, meal_of(phone, unmeasured_item()))
    (item,) = speaker.items()
    speaker.say("set_food", item=item["id"], food="pear")
    (row,) = queue()["items"]
    assert (row["food"]["key"], row["doubt"]) == ("pear", 1.0)
    speaker.say("set_mass", item=item["id"], mass_g=80)
    assert queue()["items"] == []


def test_one_number_of_meals_needs_a_look_everywhere(queue, phone, meal_of, client, admin):
    meal_of(phone, found_item(), found_item(90.0))
    meal_of(phone, unmeasured_item())
    settled = Speaker(client, admin, meal_of(phone, found_item()))
    settled.say("confirm", item=settled.items()[0]["id"])
    for item in ({"food": "apple", "amount": {"mass_g": 24}}, {"food": "apple"}):  # of the second the amount is missing
        answer = client.post("/v1/declared-meals", headers=phone.headers, json=meal_metadata(items=[item]))
        assert answer.status_code == 201
    rows = queue()["items"]
    meals = {row["meal"] for row in rows}
    listed = client.get("/v1/meals", headers=admin, params={"study": "pilot", "needs": "review"}).json()["items"]
    file = client.get("/v1/meals", headers=admin, params={"study": "pilot", "format": "ndjson"}).text.splitlines()
    overview = client.get("/v1/studies/pilot/overview", headers=admin).json()["waiting"]
    assert (len(rows), len(meals)) == (4, 3)
    assert {row["id"] for row in listed} == meals
    assert {row["meal_id"] for row in map(json.loads, file) if row["unreviewed_items"]} == meals
    assert client.get("/v1/studies/pilot/meal-counts", headers=admin).json()["needs_look"] == 3
    assert [row["meals"] for row in overview if row["status"] == "needs_look"] == [3]
    assert [len(queue(origin=origin)["items"]) for origin in ("declared", "photographed")] == [1, 3]


def test_question_of_a_reviewer_is_open_to_its_participant_until_it_is_answered(client, enrol, admin, meal_of):
    phone, other = enrol("P001"), enrol("P002")
    meal_id = meal_of(phone, found_item())
    participant, reviewer = Speaker(client, phone.headers, meal_id), Speaker(client, admin, meal_id)
    question = new_event("question", item=participant.items()[0]["id"], text="Did you peel it?")
    assert participant.refused("question", text="Why?") == (403, "event_not_yours")
    assert reviewer.send(question).status_code == 201
    (asked,) = phone.get("/v1/me/questions").json()["items"]
    assert (asked["id"], asked["meal"], asked["text"]) == (question["id"], meal_id, "Did you peel it?")
    assert other.get("/v1/me/questions").json()["items"] == []
    assert reviewer.refused("answer", question=question["id"], text="No.") == (403, "event_not_yours")
    answer = new_event("answer", question=question["id"], text="Yes.")
    assert participant.send(answer, if_match=asked["etag"]).status_code == 201
    assert phone.get("/v1/me/questions").json()["items"] == []
    assert participant.refused("answer", question=question["id"], text="No.") == (409, "question_answered")
    participant.say("undo", event=answer["id"])
    assert len(phone.get("/v1/me/questions").json()["items"]) == 1
    reviewer.say("undo", event=question["id"])
    assert phone.get("/v1/me/questions").json()["items"] == []
