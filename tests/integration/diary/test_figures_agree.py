"""Every figure that can be reached in two ways is the same: records, CSV, meals, days, summary, means, export."""

import io
import json
import zipfile

import pytest
import sqlalchemy as sa

from app.nutrition.components import HEADLINE_COLUMNS, HEADLINES
from app.people.models import Study
from app.records.recompute_records import rebuild_records

pytestmark = pytest.mark.slow

WOMAN = {"sex": "female", "birth_year": 1990, "weight_kg": 60.0}
EXACT = 1e-9  # sums in another order


def told(value):
    return pytest.approx(value, rel=EXACT, abs=1e-9) if value is not None else None


@pytest.mark.parametrize("talked_over", range(4), indirect=True)
def test_figures_agree_after_any_entries(talked_over, client, admin, state):
    phone = talked_over
    assert rebuild_records(state.database, write=False).different == 0
    records = phone.get("/v1/records", limit=1000).json()["items"]
    live = [record for record in records if record["status"] != "rejected"]
    _rejected_ones_amount_to_nothing(records)

    _export_says_the_same(phone, records)
    meals = {record["meal_id"] for record in records}
    for meal_id in meals:
        _meal_is_the_sum(phone.get(f"/v1/meals/{meal_id}").json(), [r for r in live if r["meal_id"] == meal_id])
    days = phone.get("/v1/days").json()["items"]

    for day in days:
        _day_is_the_sum(day, [record for record in live if record["local_date"] == day["local_date"]])
        _summary_is_the_day(phone, day)
    _leftovers_are_unknown_of_what_nobody_looked_at(phone, state, live)
    intake = client.get("/v1/studies/pilot/intakes", headers=admin).json()["items"][0]
    closed = [day for day in days if day["day_status"] == "closed"]
    for name in HEADLINE_COLUMNS:
        known = [day[name] for day in closed if day[name] is not None]
        assert intake["components"][name]["mean"] == told(sum(known) / len(known) if known else None)
        shares = [day[f"{name}_coverage"] for day in closed]
        mean = None if None in shares else sum(shares) / len(shares)
        assert intake["components"][name]["coverage"] == told(mean)
    whole = [
        day for day in closed if day["unmeasured_meals"] == day["unmeasured_items"] == day["provisional_items"] == 0
    ]
    assert intake["plausibility"]["days"] == sum(day["energy_kcal_coverage"] >= 1.0 - EXACT for day in whole)


def _rejected_ones_amount_to_nothing(records):
    for record in records:
        if record["status"] == "rejected":
            amounts = ("mass_g", "edible_g", "left_g", "consumed_g", *HEADLINE_COLUMNS)
            assert {record[name] for name in amounts} == {None}
        if record["density_g_per_ml"] is not None and record["mass_g"] is not None:
            by_volume = told(record["volume_ml"] * record["density_g_per_ml"])
            assert by_volume in (record["mass_g"], record["edible_g"])
        if record["consumed_g"] is not None:
            assert record["consumed_low_g"] <= record["consumed_g"] <= record["consumed_high_g"]
            expected = (record["edible_g"] - (record["left_g"] or 0.0)) * record["share"]
            assert record["consumed_g"] == told(expected)
        else:
            assert [record[name] for name in HEADLINE_COLUMNS] == [None] * len(HEADLINE_COLUMNS)
            assert record["status"] in ("needs_review", "rejected")


def _export_says_the_same(phone, records):
    answer = phone.get("/v1/me/export")
    data = json.loads(zipfile.ZipFile(io.BytesIO(answer.content)).read("data.json"))
    told_of = {record["item_id"]: record for meal in data["meals"] for record in meal["records"]}
    assert set(told_of) == {record["id"] for record in records}
    for record in records:
        for name in ("consumed_g", "edible_g", "status", "provisional", *HEADLINE_COLUMNS):
            assert told_of[record["id"]][name] == record[name]


def _meal_is_the_sum(meal, live):
    totals = meal["totals"]
    known = [record for record in live if record["consumed_g"] is not None]
    assert totals["unmeasured_items"] == len(live) - len(known)
    if known:
        assert totals["consumed_g"] == told(sum(record["consumed_g"] for record in known))
    if len(known) == 1:
        ends = (known[0]["consumed_low_g"], known[0]["consumed_high_g"])
        assert totals["consumed_interval_g"] == pytest.approx(ends)
    by_number = {one["number"]: one for one in totals["nutrients"]}
    for headline in HEADLINES:
        name, number = headline.column, headline.numbers[0]
        values = [record[name] for record in known if record[name] is not None]
        assert (by_number[number]["amount"] if values else None) == told(sum(values) if values else None)
        weights = [max(record["consumed_g"], 0.0) for record in known]
        if values and len(known) == len(live) and sum(weights) > 0:
            covered = sum(w for w, record in zip(weights, known, strict=True) if record[name] is not None)
            assert by_number[number]["coverage"] == told(covered / sum(weights))


def _day_is_the_sum(day, live):
    if day["ate_nothing"]:
        assert [day[name] for name in HEADLINE_COLUMNS] == [0.0] * len(HEADLINE_COLUMNS)
        return
    known = [record for record in live if record["consumed_g"] is not None]
    assert (day["items"], day["unmeasured_items"]) == (len(live), len(live) - len(known))
    assert day["provisional_items"] == sum(record["provisional"] for record in live)
    assert day["consumed_g"] == told(sum(record["consumed_g"] for record in known) if known else None)
    for name in HEADLINE_COLUMNS:
        values = [record[name] for record in live if record[name] is not None]
        assert day[name] == told(sum(values) if values else None)
        if len(known) < len(live) or day["unmeasured_meals"] or not live:
            assert day[f"{name}_coverage"] is None


def _leftovers_are_unknown_of_what_nobody_looked_at(phone, state, live):
    with state.database.write() as session:
        session.execute(sa.update(Study).values(expects_after_pair=True))
    for day in phone.get("/v1/days").json()["items"]:
        summed = [record for record in live if record["local_date"] == day["local_date"] and record["consumed_g"]]
        unknown = [each for each in summed if each["left_g"] is None and each["origin"] != "declared"]
        assert day["leftovers_unknown_items"] == len(unknown)
        _summary_is_the_day(phone, day)


def _summary_is_the_day(phone, day):
    body = phone.get("/v1/me/summary", date=day["local_date"]).json()
    for name in ("unmeasured_items", "unmeasured_meals", "leftovers_unknown_items"):
        assert body[name] == day[name]
    for name in HEADLINE_COLUMNS:
        found = body["components"][name]
        assert found["amount"] == told(max(day[name], 0.0) if day[name] is not None else None)
        if day[name] is not None:
            assert found["coverage"] == told(day[f"{name}_coverage"])
