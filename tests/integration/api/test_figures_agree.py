"""Every figure that can be reached in two ways is the same: records, CSV, meals, days, summary, means, export."""

import csv
import io
import json
import random
import uuid
import zipfile

import pytest
import sqlalchemy as sa

from app.db.models import Study
from app.db.models.record import HEADLINE_COLUMNS
from app.services.food_amounts import RECORD_COLUMNS
from app.services.rebuild_records import rebuild_records
from tests.estimates import unmeasured_item
from tests.integration.after_pairs import Table, apple, banana, left_of_apple, left_of_banana
from tests.integration.eaten_days import set_profile
from tests.integration.reviewing import Speaker, new_event

pytestmark = pytest.mark.slow

WOMAN = {"sex": "female", "birth_year": 1990, "weight_kg": 60.0}
FOODS = ("pear", "milk-whole", "bread-white", "apple-gala", "durian", "fruit-salad")
EXACT = 1e-9  # sums in another order


def told(value):
    return pytest.approx(value, rel=EXACT, abs=1e-9) if value is not None else None


class Chatter:
    """Says what comes to mind of a meal, by seed; what is refused is refused."""

    def __init__(self, rng, phone, reviewer):
        self.rng, self.speakers = rng, (phone, reviewer)
        self.said = []

    def say(self):
        rng = self.rng
        speaker = rng.choice(self.speakers)
        meal = speaker.meal()
        items = [item["id"] for item in meal["items"] if not {"replaced", "undone"} & set(item["flags"])]
        pieces = [piece["id"] for piece in (meal["after"] or {}).get("leftovers", [])]
        item = rng.choice(items) if items else str(uuid.uuid4())
        amount = rng.choice([None, {"mass_g": 80.0}, {"mass_g": 30.0, "of": "edible"}, {"volume_ml": 120.0}])
        event = rng.choice(
            [
                lambda: new_event("confirm", item=item),
                lambda: new_event("reject", item=item),
                lambda: new_event("set_food", item=item, food=rng.choice(FOODS)),
                lambda: new_event("set_mass", item=rng.choice([*items, *pieces] or [item]), mass_g=90.0),
                lambda: new_event("set_volume", item=rng.choice([*items, *pieces] or [item]), volume_ml=60.0),
                lambda: new_event("set_share", item=item, share=rng.choice([0.25, 0.5, 1.0])),
                lambda: new_event("split", item=item, parts=[{"share": 0.3}, {"share": 0.7, "food": "pear"}]),
                lambda: new_event("merge", items=rng.sample(items, min(2, len(items))), food="pear"),
                lambda: new_event("add", food=rng.choice(FOODS), amount=amount, share=rng.choice([0.5, 1.0])),
                lambda: new_event("set_leftover", item=rng.choice(pieces or [item]), of=item, **{"class": "food_left"}),
                lambda: new_event("nothing_left"),
                lambda: new_event("confirm_meal"),
                lambda: new_event("undo", event=rng.choice(self.said) if self.said else str(uuid.uuid4())),
            ]
        )()
        if speaker.send(event).status_code == 201:
            self.said.append(event["id"])


@pytest.fixture
def talked_over(phone, client, admin, state, request):
    """Three days of meals, some with what was left, about which people have said this and that."""
    rng = random.Random(request.param)
    with state.database.write() as session:
        session.execute(sa.update(Study).values(gives_feedback=True))
    set_profile(state, **WOMAN)
    for number in range(6):
        captured_at = f"2026-11-{17 + number // 2}T{8 + number:02}:30:00+08:00"
        table = Table(phone, state, seed=number, captured_at=captured_at)
        if rng.random() < 0.1:
            continue  # not measured yet
        table.measured(*rng.choice([(apple(), banana()), (apple(),), (apple(), unmeasured_item(hint=1))]))
        if rng.random() < 0.6:
            table.send_after().after_measured(
                *rng.choice([(left_of_apple(), left_of_banana(60.0)), (left_of_apple(200.0),)])
            )
        chatter = Chatter(rng, Speaker(client, phone.headers, table.id), Speaker(client, admin, table.id))
        for _ in range(rng.randrange(6)):
            chatter.say()
    drink = {"food": "milk-whole", "amount": {"volume_ml": 250}, "share": 0.5}
    body = {"id": str(uuid.uuid4()), "captured_at": "2026-11-18T16:00:00+08:00", "time_zone": "Asia/Shanghai"}
    answer = client.post("/v1/declared-meals", headers=phone.headers, json=body | {"items": [drink]})
    assert answer.status_code == 201, answer.text
    for day in (17, 18, 19):
        phone.put(f"/v1/me/days/2026-11-{day}", json={"status": "closed"}, headers={"If-Match": "*"})
    phone.put("/v1/me/days/2026-11-16", json={"status": "closed", "ate_nothing": True}, headers={"If-Match": "*"})
    return phone


@pytest.mark.parametrize("talked_over", range(4), indirect=True)
def test_figures_agree_whatever_was_said(talked_over, client, admin, state):
    phone = talked_over
    assert rebuild_records(state.database, write=False).different == 0
    records = phone.get("/v1/records", limit=1000).json()["items"]
    live = [record for record in records if record["status"] != "rejected"]
    _rejected_ones_amount_to_nothing(records)
    _csv_says_the_same(phone, records)
    _export_says_the_same(phone, records)
    meals = {record["meal_id"] for record in records}
    for meal_id in meals:
        _meal_is_the_sum(phone.get(f"/v1/meals/{meal_id}").json(), [r for r in live if r["meal_id"] == meal_id])
    days = phone.get("/v1/days").json()["items"]
    rows = list(csv.DictReader(io.StringIO(phone.get("/v1/days", format="csv").text)))
    assert [row["energy_kcal"] for row in rows] == [_cell(day["energy_kcal"]) for day in days]
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


def _cell(value):
    return "" if value is None else str(value)


def _rejected_ones_amount_to_nothing(records):
    for record in records:
        if record["status"] == "rejected":
            assert [record[name] for name in ("mass_g", "edible_g", "left_g", "consumed_g", *HEADLINE_COLUMNS)] == [
                None
            ] * 14
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


def _csv_says_the_same(phone, records):
    rows = list(csv.DictReader(io.StringIO(phone.get("/v1/records", format="csv").text)))
    assert [row["id"] for row in rows] == [record["id"] for record in records]
    for row, record in zip(rows, records, strict=True):
        for name in ("consumed_g", "consumed_low_g", "edible_g", "left_g", "share", *HEADLINE_COLUMNS):
            assert row[name] == _cell(record[name])


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
    for name, numbers in RECORD_COLUMNS.items():
        values = [record[name] for record in known if record[name] is not None]
        assert (by_number[numbers[0]]["amount"] if values else None) == told(sum(values) if values else None)
        weights = [max(record["consumed_g"], 0.0) for record in known]
        if values and len(known) == len(live) and sum(weights) > 0:
            covered = sum(w for w, record in zip(weights, known, strict=True) if record[name] is not None)
            assert by_number[numbers[0]]["coverage"] == told(covered / sum(weights))


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
