"""An item without a volume, from the pipeline's answer to what researchers get: kept, named, and nowhere a number."""

import csv
import io

import pytest

from app.cli.demo import show_meal
from app.nutrition.components import HEADLINE_COLUMNS
from app.records.meal_schemas import MealOut
from app.records.recompute_records import rebuild_records
from tests.integration.records.eating import eaten
from tests.support.estimates import found_item, unmeasured_item

HINTS = [{"point": [30, 20], "food": "apple"}, {"point": [60, 20], "food": "milk-whole"}]
VOLUME = ("volume_ml", "volume_low_ml", "volume_high_ml")
DERIVED = ("mass_g", "mass_low_g", "mass_high_g", "edible_g", *HEADLINE_COLUMNS)


@pytest.fixture
def meal(phone, state):
    """An apple that was measured beside milk in an opaque bowl."""
    meal_id = eaten(phone, state, found_item(hint=0), unmeasured_item(hint=1), hints=HINTS)
    return phone.get(f"/v1/meals/{meal_id}").json()


def test_meal_shows_outline_food_and_flag_no_amount_and_incomplete_totals_and_waits_for_a_person(meal, capsys):
    (apple, milk), totals = meal["items"], meal["totals"]
    assert (meal["status"], apple["status"], milk["status"]) == ("needs_review", "proposed", "needs_review")
    assert milk["polygon"] == apple["polygon"]
    assert (milk["food"]["key"], milk["flags"]) == ("milk-whole", ["not_measurable"])
    assert [candidate["food"]["key"] for candidate in milk["candidates"]] == ["milk-whole"]
    amounts = ("volume_ml", "volume_interval_ml", "mass_g", "mass_interval_g", "edible_g")
    assert [milk[name] for name in amounts] == [None] * len(amounts)
    assert milk["nutrients"] == []
    assert milk["density_g_per_ml"] > 0  # for the volume that a person sets
    assert (totals["unmeasured_items"], totals["consumed_g"]) == (1, apple["consumed_g"])
    assert {total["coverage"] for total in totals["nutrients"]} == {None}
    amounts = {one["number"]: [one["amount"], *(one["interval"] or [])] for one in apple["nutrients"]}
    assert {
        one["number"]: pytest.approx([one["amount"], *(one["interval"] or [])]) for one in totals["nutrients"]
    } == amounts
    show_meal(MealOut.model_validate(meal))
    assert "not measured: not_measurable" in capsys.readouterr().out


@pytest.mark.usefixtures("meal")
def test_records_have_nulls_in_json_and_empty_cells_in_csv_also_when_they_are_rebuilt(phone, state):
    record = phone.get("/v1/records", food="milk-whole").json()["items"][0]
    assert [record[name] for name in (*VOLUME, *DERIVED)] == [None] * len((*VOLUME, *DERIVED))
    assert record["status"] == "needs_review"
    row = next(csv.DictReader(io.StringIO(phone.get("/v1/records", food="milk-whole", format="csv").text)))
    assert {row[name] for name in (*VOLUME, *DERIVED)} == {""}
    assert row["food_key"] == "milk-whole"
    assert rebuild_records(state.database, write=False).different == 0
