"""Lists of meals: what a row says is what the meal says, who sees which, and what has changed meanwhile."""

import uuid
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa

from app.exports.lists import list_meals
from app.meals.stored.models import MealImage
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.people.people import make_staff
from tests.integration.records.reviewing import Speaker
from tests.support import estimates
from tests.support.estimates import found_item, unmeasured_item
from tests.support.photographs import pair


@pytest.fixture
def meal_of(state):
    """A phone's meal, estimated if items are given; the hint says that the first of them is an apple."""

    def meal_of(phone, *items, captured_at="2026-11-20T12:30:00+08:00"):
        body = meal_metadata(hints=[{"point": [30, 20], "food": "apple"}], captured_at=captured_at)
        assert phone.post(pair(), body).status_code == 202
        if items:
            estimates.save(state, body["id"], *items)
        return body["id"]

    return meal_of


def listed(client, headers, **params):
    answer = client.get("/v1/meals", headers=headers, params=params)
    assert answer.status_code == 200, answer.text
    return answer.json()["items"]


def ids(rows):
    return [row["id"] for row in rows]


def test_row_says_what_the_meal_says(client, admin, phone, meal_of):
    meal_id = meal_of(phone, found_item(150.0), found_item(80.0), found_item(60.0), unmeasured_item())
    speaker = Speaker(client, phone.headers, meal_id)
    speaker.say("reject", item=speaker.items()[1]["id"])
    speaker.say("set_food", item=speaker.items()[2]["id"], food="banana")
    [row] = listed(client, admin)
    meal = client.get(row["links"]["meal"], headers=admin).json()
    held = [item for item in meal["items"] if item["status"] != "rejected"]
    energy = next(total for total in meal["totals"]["nutrients"] if total["number"] == "208")
    assert len(held) == 3
    same = ("id", "study", "participant", "status", "stage", "captured_at", "time_zone", "local_date", "received_at")
    assert {name: row[name] for name in same} == {name: meal[name] for name in same}
    assert row["version"] == meal["version"]
    assert (row["item_count"], row["unmeasured_items"], row["items_without_energy"]) == (3, 1, 1)
    assert row["consumed_g"] == pytest.approx(meal["totals"]["consumed_g"], rel=1e-12)
    assert row["energy_kcal"] == pytest.approx(energy["amount"], rel=1e-12)
    assert [food["key"] for food in row["foods"]] == ["apple", "banana"]
    assert row["flags"] == list(dict.fromkeys(flag for item in held for flag in item["flags"]))
    assert (row["origin"], row["after_status"], row["failure_code"], row["doubt"]) == ("photographed", None, None, 1.0)
    assert row["provisional"] == any(item["provisional"] for item in held)
    delay = datetime.fromisoformat(row["received_at"]) - datetime.fromisoformat(row["captured_at"])
    assert row["upload_delay_seconds"] == pytest.approx(delay.total_seconds())
    assert client.get(row["links"]["photograph_left"], headers=admin).status_code == 200


def test_meal_of_which_nothing_is_known_has_no_figures_and_one_confirmed_without_foods_has_zero(client, phone, meal_of):
    unknown, empty = meal_of(phone), meal_of(phone, found_item())
    speaker = Speaker(client, phone.headers, empty)
    speaker.say("reject", item=speaker.items()[0]["id"])
    speaker.say("confirm_meal")
    rows = {row["id"]: row for row in listed(client, phone.headers)}
    assert rows[empty]["status"] == "confirmed"
    for meal_id, expected in ((unknown, None), (empty, 0.0)):
        assert rows[meal_id]["consumed_g"] == rows[meal_id]["energy_kcal"] == expected
        assert rows[meal_id]["consumed_g"] == phone.get(f"/v1/meals/{meal_id}").json()["totals"]["consumed_g"]
        assert (rows[meal_id]["item_count"], rows[meal_id]["doubt"]) == (0, None)


def test_meals_come_newest_first_page_by_page_and_the_other_way_round(client, admin, phone, meal_of):
    meals = [meal_of(phone, captured_at=f"2026-11-{day}T12:00:00+00:00") for day in (12, 14, 13, 11)]
    in_time = [meals[number] for number in (3, 0, 2, 1)]
    for order, expected in (("newest", in_time[::-1]), ("oldest", in_time)):
        path, seen = f"/v1/meals?order={order}&limit=3&status=queued&status=failed", []
        while path:
            page = client.get(path, headers=admin).json()
            path, seen = page["next"], seen + ids(page["items"])
        assert seen == expected


def test_filters_are_told_in_the_address(client, admin, enrol, meal_of, state):
    first, second = enrol("P001"), enrol("P002")
    plain = meal_of(first, found_item(), captured_at="2026-11-18T12:00:00+00:00")
    flagged = meal_of(second, found_item(flags=["low_texture"]), captured_at="2026-11-19T12:00:00+00:00")
    asked = meal_of(second, unmeasured_item(), captured_at="2026-11-20T12:00:00+00:00")
    waiting = meal_of(second, captured_at="2026-11-21T12:00:00+00:00")
    Speaker(client, admin, asked).say("question", text="How much of it?")
    speaker = Speaker(client, admin, plain)
    speaker.say("confirm", item=speaker.items()[0]["id"])
    for params, expected in (
        ({}, [waiting, asked, flagged, plain]),
        ({"flag": ["low_texture", "inside_guessed"]}, [flagged]),
        ({"flag": "not_measurable", "food": "apple"}, [asked]),
        ({"food": "apple", "to": "2026-11-19"}, [flagged, plain]),
        ({"food": "banana"}, []),
        ({"status": ["queued", "needs_review"], "participant": "P002"}, [waiting, asked]),
        ({"needs": "review"}, [asked, flagged]),
        ({"needs": "answer"}, [asked]),
        ({"from": "2026-11-19", "to": "2026-11-20", "origin": "photographed"}, [asked, flagged]),
        ({"origin": "declared"}, []),
        ({"after_status": "failed"}, []),
    ):
        assert ids(listed(client, admin, **params)) == expected, params
    estimates.save(state, waiting, failure={"code": "marker_not_found", "message": "No board.", "advice": "Lay it."})
    [row] = listed(client, admin, failure=["marker_not_found", "baseline_too_small"], status="failed")
    assert (row["id"], row["failure_code"], row["consumed_g"]) == (waiting, "marker_not_found", None)
    with state.database.write() as session:
        session.execute(sa.update(MealImage).where(MealImage.slot == "left").values(erased_at=datetime.now(UTC)))
    assert {row["links"]["photograph_left"] for row in listed(client, admin)} == {None}


def test_phone_sees_its_participants_meals_and_staff_those_of_their_studies(client, admin, enrol, meal_of):
    mine, other, elsewhere = enrol("P001"), enrol("P002"), enrol("P001", study="other")
    meals = [meal_of(phone) for phone in (mine, other, elsewhere)]
    viewer = make_staff(client, admin, "viewer", pilot="viewer")
    [row] = listed(client, mine.headers)
    assert row["id"] == meals[0]
    assert "participant=" not in row["links"]["meal"]
    assert client.get(row["links"]["photograph_left"], headers=mine.headers).status_code == 200
    for params in ({"participant": "P002"}, {"study": "other"}):
        assert client.get("/v1/meals", headers=mine.headers, params=params).status_code == 404
    assert set(ids(listed(client, viewer.headers))) == {*meals[:2]}
    assert client.get("/v1/meals", headers=viewer.headers, params={"study": "other"}).status_code == 404
    assert listed(client, make_staff(client, admin, "stranger").headers) == []
    assert set(ids(listed(client, admin))) == {*meals}


def test_counts_tell_that_there_are_more_than_they_counted(client, admin, enrol, meal_of, monkeypatch):
    monkeypatch.setattr(list_meals, "MOST_COUNTED", 2)
    for phone in (enrol("P001"), enrol("P002"), enrol("P001"), enrol("P001", study="other")):
        meal_of(phone)
    meal_of(enrol("P002"), found_item())
    counts = client.get("/v1/studies/pilot/meal-counts", headers=admin).json()["items"]
    assert [count["status"] for count in counts] == [
        "receiving", "queued", "processing", "estimated", "needs_review", "failed", "confirmed"
    ]  # fmt: skip
    found = {count["status"]: (count["count"], count["is_more"]) for count in counts if count["count"]}
    assert found == {"queued": (2, True), "estimated": (1, False)}


def test_changed_meals_are_those_whose_version_is_another(client, admin, phone, meal_of, state):
    still, moved, gone = meal_of(phone), meal_of(phone), uuid.uuid4()
    known = [f"{row['id']}:{row['version']}" for row in listed(client, admin)] + [f"{gone}:1"]

    def changed(study="pilot"):
        answer = client.get(f"/v1/studies/{study}/changed-meals", headers=admin, params={"meal": known})
        assert answer.status_code == 200, answer.text
        return answer.json()["items"]

    assert changed() == []
    estimates.save(state, moved, found_item())
    [row] = changed()
    assert row == next(each for each in listed(client, admin) if each["id"] == moved)
    assert (row["status"], still in ids([row])) == ("estimated", False)
    client.post("/v1/studies", headers=admin, json={"code": "other", "name": "other"})
    assert changed("other") == []
    for broken in ("x:1", f"{still}:x", f"{still}", f"{'-' * 36}:1"):
        answer = client.get("/v1/studies/pilot/changed-meals", headers=admin, params={"meal": broken})
        assert refusal(answer) == (422, "invalid_input")
