"""Foods and densities made and corrected over HTTP: history, concurrency, what is refused; attacks."""

from dataclasses import replace
from datetime import date
from functools import partial

import pytest

from app.foods.food_releases import use_release
from app.foods.import_foods import import_foods, load_starter
from app.foods.importers.source_files import ImportedTable, Skipped
from app.foods.models import FoodDensity
from app.foods.queries import foods_by_key
from app.nutrition.components import COMPONENT_BY_NUMBER
from app.nutrition.foods import load_starter_table
from tests.integration.foods.editing import QUARK, refused
from tests.integration.records.at_once import at_once


def test_a_new_food_is_made_found_and_read_back(staff):
    made = staff.food()
    assert made.status_code == 201, made.json()
    assert made.headers["location"] == "/v1/foods/quark-low-fat"
    food = staff.get(made.headers["location"])
    assert food.json() == made.json()
    assert food.headers["etag"] == made.headers["etag"]
    body = food.json()
    assert (body["version"], body["release"]) == (1, "local 1")
    assert staff.nutrients("quark-low-fat") == {"208": 67.0, "203": 12.5, "301": 120.0}  # 0.12 g of calcium in mg
    assert body["density"]["chosen"]["g_per_ml"] == 1.05
    assert staff.get("/v1/foods?q=quark low fat").json()["items"][0]["key"] == "quark-low-fat"
    (change,) = staff.get("/v1/foods/quark-low-fat/changes").json()["items"]
    assert change["author"] == "staff: admin"
    assert change["reason"] == QUARK["reason"]
    assert (change["previous_version"], change["differences"]) == (None, {})


@pytest.mark.both_stores
def test_a_key_that_is_taken_is_a_conflict(staff):
    refused(staff.food(key="apple"), 409, "food_exists")
    assert staff.food().status_code == 201
    refused(staff.food(), 409, "food_exists")


@pytest.mark.both_stores
def test_null_takes_a_figure_away_and_a_corrected_density_is_not_undone_by_the_row_that_it_corrects(staff):
    assert "401" in staff.nutrients("apple")
    density = {"g_per_ml": 0.9, "sd_g_per_ml": 0.02, "state": "raw", "kind": "solid", "source": "ours"}
    assert staff.patch("apple", nutrients={"401": None, "CAFFN": None}, densities=[density]).status_code == 200
    assert not {"401", "262"} & set(staff.nutrients("apple"))  # unknown, and not zero
    choice = staff.get("/v1/foods/apple").json()["density"]
    assert choice["chosen"]["g_per_ml"] == 0.9
    assert not any(other["source"].startswith("ECUSTFD") for other in choice["alternatives"])


@pytest.mark.both_stores
def test_an_edit_copies_the_foods_own_densities_not_those_pooled_from_other_tables(staff, state):
    def own():
        with state.database.read() as session:
            food = foods_by_key(session, ["apple"])["apple"]
            return [row.source for row in session.query(FoodDensity).filter_by(food_id=food.id)]

    before = own()
    staff.patch("apple", name="another name")
    assert own() == before


def test_the_tag_is_asked_for_and_must_be_the_one_in_force(staff, client, admin):
    body = {"name": "x", "reason": "y"}
    refused(client.patch("/v1/foods/apple", headers=admin, json=body), 428, "precondition_required")
    tag = staff.get("/v1/foods/apple").headers["etag"]
    assert staff.patch("apple", tag, name="first").status_code == 200
    assert refused(staff.patch("apple", tag, name="second"), 412, "food_changed_since")["version"] == 2
    for wrong in ('""', "W/" + tag, '"-1"', '"' + "9" * 400 + '"', '"1e3"'):
        refused(staff.patch("apple", wrong, name="third"), 412, "food_changed_since")
    for wrong in ("apple", "\x7f"):
        refused(staff.patch("apple", wrong, name="third"), 400, "malformed_request")
    now = staff.get("/v1/foods/apple").headers["etag"]
    assert staff.patch("apple", f'"0", {now}', name="fourth").status_code == 200
    assert staff.patch("apple", "*", name="fifth").status_code == 200


@pytest.mark.both_stores
def test_of_corrections_at_the_same_time_one_wins(staff):
    tag = staff.get("/v1/foods/banana").headers["etag"]
    answers = at_once(*(partial(staff.patch, "banana", tag, name=f"banana {n}") for n in range(6)))
    assert sorted(answer.status_code for answer in answers) == [200, 412, 412, 412, 412, 412]
    winner = next(answer for answer in answers if answer.status_code == 200)
    assert staff.get("/v1/foods/banana").json() == winner.json()
    assert len(staff.get("/v1/foods/banana/changes").json()["items"]) == 1


@pytest.mark.both_stores
def test_of_the_same_food_made_at_the_same_time_one_is_made(staff):
    answers = at_once(*(partial(staff.food, name=f"Quark {n}") for n in range(6)))
    assert sorted(answer.status_code for answer in answers) == [201, 409, 409, 409, 409, 409]


@pytest.mark.both_stores
def test_densities_added_at_the_same_time_are_all_kept(staff):
    def add(n):
        body = {"g_per_ml": 0.5 + n / 100, "sd_g_per_ml": 0.01, "state": "raw", "kind": "solid"}
        return staff.post("/v1/foods/banana/densities", body | {"method": f"scale {n}", "reason": "measured"})

    answers = at_once(*(partial(add, n) for n in range(4)))
    assert [answer.status_code for answer in answers] == [201] * 4, [answer.json() for answer in answers]
    choice = staff.get("/v1/foods/banana").json()["density"]
    found = {choice["chosen"]["source"], *(other["source"] for other in choice["alternatives"])}
    assert {f"scale {n}" for n in range(4)} <= found


def test_a_food_is_put_back_by_a_new_version_to_what_it_was_before_any_correction(staff):
    original = staff.get("/v1/foods/apple").json()
    staff.patch("apple", name="wrong", nutrients={"401": None}, densities=[])
    tag = staff.get("/v1/foods/apple").headers["etag"]
    back = staff.post("/v1/foods/apple/restore", {"version": 1, "reason": "a mistake"}, **{"If-Match": tag})
    assert back.status_code == 200, back.json()
    unlike = {name for name in original if original[name] != back.json()[name]}
    assert unlike == {"version", "release"}
    changes = staff.get("/v1/foods/apple/changes").json()["items"]
    assert [change["version"] for change in changes] == [3, 2]
    assert changes[0]["differences"]["name"] == ["wrong", original["name"]]
    tag = back.headers["etag"]
    missing = staff.post("/v1/foods/apple/restore", {"version": 9, "reason": "?"}, **{"If-Match": tag})
    refused(missing, 404, "food_version_not_found")
    assert staff.post("/v1/foods/apple/restore", {"version": 1, "reason": "no tag"}).status_code == 428


def test_figures_that_cannot_be_are_refused(staff):
    for nutrients, code in (
        ({"VITX": {"per_100_g": 1, "unit": "mg"}}, "component_unknown"),
        ({"ENERC_KCAL": {"per_100_g": 50, "unit": "g"}}, "unit_differs"),
        ({"VITC": {"per_100_g": 5, "unit": "IU"}}, "unit_differs"),
        ({"VITC": {"per_100_g": 5, "unit": "mg"}, "401": {"per_100_g": 6, "unit": "mg"}}, "component_repeated"),
        ({"PROCNT": {"per_100_g": 60, "unit": "g"}, "FAT": {"per_100_g": 60, "unit": "g"}}, "figures_impossible"),
        ({"NA": {"per_100_g": 101, "unit": "g"}}, "figures_impossible"),
        ({"ENERC_KCAL": {"per_100_g": 2000, "unit": "kcal"}}, "figures_impossible"),
    ):
        body = refused(staff.food(nutrients=nutrients), 422, code)
        refused(staff.patch("apple", nutrients=nutrients), 422, code)
        if code == "component_unknown":
            assert body["component"] == "VITX"
            assert "VITX" in body["detail"]
    assert staff.get("/v1/foods/quark-low-fat").status_code == 404
    assert staff.get("/v1/foods/apple").json()["version"] == 1


def test_what_a_food_cannot_be_is_refused(staff):
    fields = {
        "name": ("", "  ", "x" * 301, "a\0b", 5),
        "key": ("Apple", "09003", "../x", "a\n", "x" * 101),
        "form": ("cube",),
        "state": ("burnt",),
        "group": (None,),
        "reason": (None, "", "\t"),
        "unknown_field": (1,),
        "is_mixed_dish": ("yes",),
        "refuse": (
            [{"part": "peel", "percent": 60}, {"part": "core", "percent": 40}],
            [{"part": "peel", "percent": 10}, {"part": "peel", "percent": 10}],
            [{"part": "peel", "percent": -1}],
        ),
        "portions": ([{"amount": 1, "measure": "cup", "mass_g": 0}],),
        "densities": ([{"g_per_ml": 0, "sd_g_per_ml": 0, "state": "x", "kind": "solid", "source": "x"}],),
        "nutrients": (
            *({"VITC": {"per_100_g": figure, "unit": "mg"}} for figure in (-1, 1e308, True, "5", None)),
            *({"VITC": figure} for figure in (None, 5, {"per_100_g": 5, "unit": "lb"})),
            {"\0": {"per_100_g": 5, "unit": "mg"}},
            [],
        ),
        "aliases": (["x"] * 101,),
        "source_ids": ({"A B": "1"}, {"sr28_ndb": ""}),
        "probes": (["DROP TABLE"],),
    }
    for name, values in fields.items():
        for value in values:
            answer = staff.food(**{name: value})
            assert answer.status_code == 422, (name, value)
            assert answer.json()["code"] in {"invalid_input", "food_invalid"}
    assert staff.get("/v1/foods/quark-low-fat").status_code == 404


def test_broken_bodies_are_refused_and_change_nothing(staff, client, admin):
    headers = admin | {"If-Match": "*", "Content-Type": "application/json"}
    for raw in (
        b"",
        b"{",
        b"null",
        b"\xff\xfe",
        b'{"nutrients": {"VITC": {"per_100_g": NaN, "unit": "mg"}}, "reason": "r"}',
        b'{"nutrients": {"VITC": {"per_100_g": 1e999, "unit": "mg"}}, "reason": "r"}',
        b'{"name": "\\ud800", "reason": "r"}',
        b'{"nutrients": {"\\ud800": null}, "reason": "r"}',
        b'{"\\ud800": null, "reason": "r"}',
        b"[" * 100_000,
        b'{"reason": "r", "nutrients": ' + b'{"x":' * 50_000 + b"1" + b"}" * 50_000 + b"}",
    ):
        for method, path in (("PATCH", "/apple"), ("POST", ""), ("POST", "/apple/densities")):
            answer = client.request(method, f"/v1/foods{path}", headers=headers, content=raw)
            assert 400 <= answer.status_code < 500, raw[:50]
            assert answer.json()["code"]
    assert staff.get("/v1/foods/apple").json()["version"] == 1


def test_a_correction_survives_a_new_release_of_its_table(staff, state):
    staff.patch("apple", name="Ours")
    load_starter(state.database)
    starter = load_starter_table()
    foods = tuple(replace(food, name=f"New {food.name}") for food in starter.foods[:3])
    table = replace(starter, version="999", released_on=date(2030, 1, 1), checksum="f" * 64, foods=foods)
    imported = ImportedTable("starter", table, tuple(COMPONENT_BY_NUMBER.values()), Skipped())
    import_foods(state.database, imported, author="a test")
    assert staff.get("/v1/foods/apple").json()["name"] == "Ours"
    assert staff.get("/v1/foods/banana").json()["name"].startswith("New ")


def test_corrections_that_are_out_of_force_are_told(staff, state):
    staff.food()
    use_release(state.database, "local", None, author="a test")
    refused(staff.patch("apple", name="x"), 409, "local_foods_off")
    use_release(state.database, "local", "1", author="a test")
    assert staff.patch("apple", name="x").status_code == 200
