"""Meals that are entered without photographs."""

import uuid

import pytest
import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.records.recompute_records import rebuild_records
from tests.integration.meals.upload.answers import refusal
from tests.integration.records.reviewing import Speaker
from tests.support.photographs import pair


def told(*items, **changes):
    return {
        "id": str(uuid.uuid4()),
        "captured_at": "2026-11-20T16:00:00+08:00",
        "time_zone": "Asia/Shanghai",
        "items": list(items) or [{"food": "milk-whole", "amount": {"volume_ml": 250}}],
    } | changes


@pytest.fixture
def declare(client, phone):
    def declare(body):
        return client.post("/v1/declared-meals", headers=phone.headers, json=body)

    return declare


def test_declared_meal_is_confirmed_and_its_foods_count_by_what_was_told(declare, phone, state):
    body = told({"food": "milk-whole", "amount": {"volume_ml": 250}}, {"food": "bread-white", "amount": {"mass_g": 60}})
    answer = declare(body)
    meal = answer.json()
    assert (answer.status_code, answer.headers["location"]) == (201, f"/v1/meals/{body['id']}")
    assert (meal["status"], meal["images"], meal["local_date"]) == ("confirmed", {}, "2026-11-20")
    milk, bread = meal["items"]
    assert [item["origin"] for item in (milk, bread)] == ["declared", "declared"]
    assert milk["mass_g"] == pytest.approx(250 * milk["density_g_per_ml"])
    assert bread["mass_g"] == pytest.approx(60)
    low, high = bread["mass_interval_g"]
    assert (low, high) == pytest.approx((60 / 1.50, 60 * 1.50), rel=0.01)  # exp(1.645 x 0.246): a relative sd of 0.25
    assert [row["origin"] for row in phone.get("/v1/records").json()["items"]] == ["declared", "declared"]
    assert rebuild_records(state.database, write=False).different == 0


def test_same_meal_again_adds_nothing_and_another_of_its_id_or_of_an_unknown_food_is_refused(declare, phone):
    body = told()
    first, again = declare(body), declare(body)
    assert (first.status_code, again.status_code) == (201, 200)
    assert again.json() == first.json()
    other = body | {"items": [{"food": "milk-whole", "amount": {"volume_ml": 100}}]}
    assert refusal(declare(other)) == refusal(phone.post(pair(), id=body["id"])) == (409, "meal_id_reused")
    unknown = told({"food": "no-such-food", "amount": {"mass_g": 10}})
    assert refusal(declare(unknown)) == (422, "food_unknown")
    assert phone.get(f"/v1/meals/{unknown['id']}").status_code == 404


def test_food_without_an_amount_waits_for_one_and_nothing_is_drawn_on_no_photograph(declare, client, phone):
    body = told({"food": "milk-whole"})
    assert declare(body).json()["status"] == "needs_review"
    speaker = Speaker(client, phone.headers, body["id"])
    (milk,) = speaker.items()
    polygon = [[0, 0], [10, 0], [10, 10]]
    assert speaker.refused("redraw", item=milk["id"], polygon=polygon) == (409, "photographs_missing")
    assert speaker.say("set_volume", item=milk["id"], volume_ml=200)["status"] == "confirmed"


def test_copied_entry_is_marked_and_the_others_are_not(declare, phone, state):
    amount = {"mass_g": 60, "of": "edible", "relative_sd": 0.15}
    body = told(
        {"food": "apple", "amount": amount, "copied": True}, {"food": "milk-whole", "amount": {"volume_ml": 250}}
    )
    apple, milk = declare(body).json()["items"]
    assert (apple["flags"], milk["flags"]) == (["copied"], [])
    assert (apple["consumed_g"], apple["status"]) == (60, "confirmed")
    assert declare(body).status_code == 200
    with state.database.read() as session:
        details = session.scalars(sa.select(Meal)).one().details["declared"]
    assert [item.get("copied") for item in details] == [True, None]  # as before there were copies
    assert sorted(row["flags"] for row in phone.get("/v1/records").json()["items"]) == [[], ["copied"]]
    assert rebuild_records(state.database, write=False).different == 0


@pytest.mark.both_stores
def test_favourites_are_kept_as_the_participant_names_them_for_nobody_else(client, phone, declare, enrol):
    oats = {"name": "Haferflocken", "items": [{"food": "milk-whole", "amount": {"volume_ml": 200}}]}
    cake = {"name": "cake", "items": [{"food": "apple"}]}
    url = "/v1/me/favourites"
    assert phone.get(url).json() == {"items": []}
    for favourites in ([oats, cake], [cake]):
        kept = client.put(url, headers=phone.headers, json={"items": favourites})
        assert kept.status_code == 200
        assert [each["name"] for each in kept.json()["items"]] == [each["name"] for each in favourites]
        assert phone.get(url).json() == kept.json()
    assert enrol("another").get(url).json() == {"items": []}
    (favourite,) = phone.get(url).json()["items"]
    assert declare(told(*favourite["items"])).json()["items"][0]["food"]["key"] == "apple"
