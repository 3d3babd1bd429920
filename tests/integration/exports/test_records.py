import csv
import io
import uuid

import pytest
import sqlalchemy as sa

from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord, Item, Run
from app.nutrition.components import HEADLINE_BY_COLUMN, HEADLINE_COLUMNS
from tests.integration.conftest import meal_metadata
from tests.integration.meals.upload.answers import refusal
from tests.integration.records.eating import APPLE_HINT, eaten
from tests.support import estimates
from tests.support.estimates import found_item
from tests.support.photographs import pair


def test_hinted_food_becomes_one_record_with_mass_and_nutrients_and_their_intervals(phone, state):
    meal_id = eaten(phone, state)
    estimates.save(state, meal_id, found_item())  # the same job again
    meal = phone.get(f"/v1/meals/{meal_id}").json()
    item = meal["items"][0]
    assert meal["status"] == "estimated"
    assert (item["food"]["key"], item["status"]) == ("apple", "proposed")
    assert item["mass_g"] == pytest.approx(185 * item["density_g_per_ml"])
    assert item["mass_interval_g"][0] < item["mass_g"] < item["mass_interval_g"][1]
    energy = next(n for n in item["nutrients"] if n["tagname"] == "ENERC_KCAL")
    assert energy["amount"] == pytest.approx(0.52 * item["edible_g"])  # SR28 09003: 52 kcal in 100 g
    (record,) = phone.get("/v1/records").json()["items"]
    assert record["energy_kcal"] == pytest.approx(energy["amount"])
    assert (record["meal_id"], record["participant"]) == (meal_id, "P001")
    by_number = {each["number"]: each["interval"] for each in item["nutrients"]}
    intervals = record["nutrient_intervals"]
    assert list(intervals) == list(HEADLINE_COLUMNS)
    for column, low_high in intervals.items():
        assert low_high == pytest.approx(by_number[HEADLINE_BY_COLUMN[column].numbers[0]]), column
        assert low_high[0] < record[column] < low_high[1]
    with state.database.read() as session:
        assert [session.query(table).count() for table in (Run, Item, EffectiveRecord)] == [1, 1, 1]
    for meal in (meal_id, uuid.uuid4()):
        assert phone.get(f"/v1/meals/{meal}/artefacts/overlay.jpg").status_code == 404


def test_food_without_fat_by_its_table_has_no_interval_of_fat(phone, state):
    hints = [{"point": [1, 2], "food": "honey"}]
    meal = phone.get(f"/v1/meals/{eaten(phone, state, hints=hints)}").json()
    record = phone.get("/v1/records").json()["items"][0]
    assert (record["fat_g"], record["nutrient_intervals"]["fat_g"]) == (0.0, None)
    for rows in (meal["items"][0]["nutrients"], meal["totals"]["nutrients"]):
        (fat,) = (each for each in rows if each["tagname"] == "FAT")
        assert (fat["amount"], fat["interval"]) == (0.0, None)
        assert next(each for each in rows if each["tagname"] == "ENERC_KCAL")["interval"] is not None


def test_meal_without_an_item_or_with_a_food_that_the_table_lacks_by_now_needs_review(phone, state):
    body, empty = meal_metadata(hints=APPLE_HINT), meal_metadata(captured_at="2026-11-21T12:30:00+08:00")
    for one in (body, empty):
        assert phone.post(pair(), one).status_code == 202
    with state.database.write() as session:
        meal = session.scalars(sa.select(Meal).where(Meal.client_id == uuid.UUID(body["id"]))).one()
        meal.details = meal.details | {"hints": [{"point": [1, 2], "food": "phoenix-roasted"}]}
    estimates.save(state, body["id"], found_item())
    estimates.save(state, empty["id"])
    for one in (body, empty):
        assert phone.get(f"/v1/meals/{one['id']}").json()["status"] == "needs_review"


def test_hint_that_cannot_be_is_refused_and_one_that_leans_over_the_border_is_taken(phone, state):
    for hint, code, told in (
        ({"point": [1, 2], "food": "phoenix-roasted"}, "food_unknown", {"foods": ["phoenix-roasted"]}),
        ({"point": [5000, 2]}, "hint_outside", {"hints": [1]}),
        ({"box": [-50, 2, 40, 40]}, "hint_outside", {"hints": [1]}),
        ({"polygon": [[1, 5000], [2, 5000], [2, 5100]]}, "hint_outside", {"hints": [1]}),
        ({"polygon": [[[1, 5000], [2, 5000], [2, 5100]]]}, "hint_outside", {"hints": [1]}),
    ):
        refused = phone.post(pair(), meal_metadata(hints=[*APPLE_HINT, hint]))
        assert refusal(refused) == (422, code)
        assert told.items() <= refused.json().items()
    with state.database.read() as session:
        assert session.scalars(sa.select(Meal)).all() == []
    hints = [{"box": [-20, -20, 100, 100]}, {"polygon": [[-5, -5], [30, 0], [30, 30]]}]
    assert phone.post(pair(), meal_metadata(hints=hints)).status_code == 202


def test_phone_says_that_its_hints_are_all_that_there_is(phone, state):
    body = meal_metadata(hints=APPLE_HINT, complete=True)
    assert phone.post(pair(), body).status_code == 202
    assert phone.post(pair(), body).status_code == 200
    other = phone.post(pair(), body | {"complete": False})
    assert (other.status_code, other.json()["fields"]) == (409, ["complete"])
    with state.database.read() as session:
        assert session.scalars(sa.select(Meal)).one().details["complete"] is True
    assert phone.post(pair(1), meal_metadata(complete="yes")).json()["code"] == "metadata_invalid"


def test_values_out_of_range_are_refused(phone):
    for bad in ({"limit": 0}, {"limit": 1001}, {"from": "yesterday"}, {"status": "eaten"}, {"format": "xml"}):
        assert phone.get("/v1/records", **bad).status_code == 422


def test_item_without_food_has_no_mass_and_empty_cells_in_csv_and_its_meal_needs_review(phone, state, client):
    headers = phone.headers | {"Accept": "text/csv"}
    (header,) = client.get("/v1/records", headers=headers).text.splitlines()
    assert header.startswith("id,meal_id,study,participant")
    meal = phone.get(f"/v1/meals/{eaten(phone, state, found_item(hint=None))}").json()
    item = meal["items"][0]
    assert (meal["status"], item["status"]) == ("needs_review", "needs_review")
    assert (item["food"], item["mass_g"], item["mass_interval_g"], item["nutrients"]) == (None, None, None, [])
    assert item["volume_ml"] == 185.0
    answer = client.get("/v1/records", headers=headers)
    assert answer.headers["content-type"].startswith("text/csv")
    row = next(csv.DictReader(io.StringIO(answer.text)))
    assert (row["food_key"], row["mass_g"], row["energy_kcal"], row["volume_ml"]) == ("", "", "", "185.0")


def test_participant_sees_own_records_only(enrol, state):
    one, other = enrol("P001"), enrol("P002")
    eaten(one, state)
    assert len(one.get("/v1/records").json()["items"]) == 1
    assert other.get("/v1/records").json()["items"] == []
    assert other.get("/v1/records", participant="P001").status_code == 404
