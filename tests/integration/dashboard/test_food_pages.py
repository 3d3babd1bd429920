"""The foods' pages: search with figures, the page of a food, where it is used; figures are the API's."""

import csv
import io
import re

from app.dashboard.food_pages.foods import FoodRow
from app.dashboard.page import csv_file
from tests.integration.dashboard.conftest import figures_of, text_of
from tests.integration.diary.eaten_days import add_meal, eaten_item


def rows_of(answer):
    assert answer.headers["content-type"].startswith("text/csv"), answer.text[:500]
    return list(csv.DictReader(io.StringIO(answer.text)))


def section(page, heading):
    """What stands under a heading of this id, to the end of its section."""
    return re.search(rf'id="{heading}".*?</section>', page, re.DOTALL)[0]


def test_figures_of_the_list_are_those_of_each_food(client, admin, sign_in_browser):
    browser = sign_in_browser("vera")
    page = browser.page("/dashboard/foods", q="spagetti")
    rows = rows_of(browser.get("/dashboard/foods", q="spagetti", format="csv"))
    found = client.get("/v1/foods", headers=admin, params={"q": "spagetti"}).json()["items"]
    assert [row["key"] for row in rows] == [food["key"] for food in found], "a typo finds what the API finds"
    shown = []
    for row in rows:
        food = client.get(f"/v1/foods/{row['key']}", headers=admin).json()
        energy = {nutrient["number"]: nutrient["per_100_g"] for nutrient in food["nutrients"]}["208"]
        chosen = food["density"]["chosen"]
        told = (float(row["energy_kcal_per_100_g"]), float(row["density_g_per_ml"]), row["density_source"])
        assert told == (energy, chosen["g_per_ml"], chosen["source"])
        shown += [energy, chosen["g_per_ml"]]
    assert figures_of(page) == shown


def test_foods_are_found_by_words_group_and_number_of_a_published_table(sign_in_browser):
    browser = sign_in_browser("vera")
    answer = browser.get("/dashboard/foods", q="Apfel", group="", headers={"HX-Request": "true"})
    assert "<html" not in answer.text, "rows only, while somebody is typing"
    assert "/dashboard/foods/apple" in answer.text
    assert answer.headers["HX-Replace-Url"] == "/dashboard/foods?q=Apfel"
    rows = rows_of(browser.get("/dashboard/foods", q="apple", group="Baked Products", format="csv"))
    assert {row["group"] for row in rows} == {"Baked Products"}
    assert "No food of the tables" in browser.page("/dashboard/foods", group="Moon rocks")
    assert "Apple, raw, with skin" in browser.page("/dashboard/foods/09003")
    assert browser.get("/dashboard/foods/moon-rock").status_code == 404
    assert "Correct it" not in browser.page("/dashboard/foods/apple"), "admins only"
    assert "New food" not in browser.page("/dashboard/foods")


def test_page_of_a_food_has_each_figure_of_the_api_and_distinguishes_unknown_from_zero(client, admin, sign_in_browser):
    browser = sign_in_browser("vera")
    food = client.get("/v1/foods/apple", headers=admin).json()
    page = browser.page("/dashboard/foods/apple")
    nutrients = section(page, "nutrients")
    shown = figures_of(nutrients)
    assert sorted(shown) == sorted(nutrient["per_100_g"] for nutrient in food["nutrients"])
    assert 0.0 in shown, "caffeine is known, and none"
    assert "Iodine" in nutrients[nutrients.index("Not known") :]
    rows = rows_of(browser.get("/dashboard/foods/apple", format="csv"))
    assert [(row["number"], float(row["per_100_g"])) for row in rows] == [
        (nutrient["number"], nutrient["per_100_g"]) for nutrient in food["nutrients"]
    ]
    densities = [food["density"]["chosen"], *food["density"]["alternatives"]]
    expected = [figure for one in densities for figure in (one["g_per_ml"], one["sd_g_per_ml"])]
    told = figures_of(section(page, "densities"))
    assert told[2 : 2 + len(expected)] == expected
    for density in densities:
        assert density["source"].split('"')[0] in text_of(page)
    assert [portion["mass_g"] for portion in food["portions"]] == told[-len(food["portions"]) :]
    assert food["edible_share"] in figures_of(page)


def test_records_are_counted_in_the_callers_studies_only(client, admin, phone, state, sign_in_browser):
    client.post("/v1/studies", headers=admin, json={"code": "other", "name": "Other", "marker": "plain:9x7:11"})
    for day in ("2026-11-01", "2026-11-02"):
        apples = (eaten_item(100.0, "apple"), eaten_item(50.0, "apple", status="rejected"))
        add_meal(state, "P001", day, *apples, eaten_item(50.0, "rice-white-cooked"))
    filters = {"study": "pilot", "food": "apple"}
    told = client.get("/v1/records", headers=admin, params=filters).json()["items"]
    assert len(told) == 4
    holding = [record for record in told if record["status"] != "rejected"]
    uses = section(sign_in_browser("vera", pilot="viewer").page("/dashboard/foods/apple"), "uses")
    assert figures_of(uses)[0] == len(holding)
    assert "/dashboard/studies/pilot/meals?food=apple" in uses
    assert "In none of your studies" in sign_in_browser("sam", other="owner").page("/dashboard/foods/apple")


def test_file_names_hold_no_special_characters_of_headers():
    for name in ('foods";x="', "nutrients\r\nX: y"):
        told = csv_file(FoodRow, [], name).headers["content-disposition"]
        assert re.fullmatch(r'attachment; filename="[A-Za-z0-9_.-]+\.csv"', told)
