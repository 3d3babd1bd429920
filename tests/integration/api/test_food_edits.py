"""Foods and densities made and corrected over HTTP: history, concurrency, what is refused; attacks."""

import json
import threading

import pytest

from app.services.import_foods import import_foods, load_starter

QUARK = {
    "key": "quark-low-fat",
    "name": "Quark, low fat",
    "group": "Dairy and Egg Products",
    "form": "in_vessel",
    "state": "as_eaten",
    "nutrients": {
        "ENERC_KCAL": {"per_100_g": 67, "unit": "kcal"},
        "PROCNT": {"per_100_g": 12.5, "unit": "g"},
        "CA": {"per_100_g": 0.12, "unit": "g"},
    },
    "densities": [
        {"g_per_ml": 1.05, "sd_g_per_ml": 0.03, "state": "as sold", "kind": "bulk", "source": "weighed in a cup"}
    ],
    "reason": "Asked for by the pilot study",
}


@pytest.fixture
def staff(client, admin):
    """The API as an admin uses it."""

    class Staff:
        def get(self, path):
            return client.get(path, headers=admin)

        def post(self, path, body, **headers):
            return client.post(path, headers=admin | headers, json=body)

        def food(self, **changes):
            return self.post("/v1/foods", {k: v for k, v in (QUARK | changes).items() if v is not None})

        def patch(self, key, tag=None, **body):
            tag = tag or client.get(f"/v1/foods/{key}", headers=admin).headers["etag"]
            return client.patch(f"/v1/foods/{key}", headers=admin | {"If-Match": tag}, json={"reason": "a test"} | body)

        def nutrients(self, key):
            return {row["number"]: row["per_100_g"] for row in self.get(f"/v1/foods/{key}").json()["nutrients"]}

    return Staff()


def refused(answer, status, code):
    body = answer.json()
    assert (answer.status_code, body["code"]) == (status, code), body
    assert len(body["detail"]) > 20
    return body


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


def test_a_key_that_is_taken_is_a_conflict(staff):
    refused(staff.food(key="apple"), 409, "food_exists")
    assert staff.food().status_code == 201
    refused(staff.food(), 409, "food_exists")


def test_a_correction_is_a_version_that_goes_before_the_table_and_leaves_it_as_it_is(staff):
    before = staff.get("/v1/foods/apple").json()
    done = staff.patch("apple", name="Apple of our orchard", nutrients={"VITC": {"per_100_g": 12, "unit": "mg"}})
    assert done.status_code == 200, done.json()
    after = staff.get("/v1/foods/apple").json()
    assert (after["name"], after["version"], after["release"]) == ("Apple of our orchard", 2, "local 1")
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"name", "version", "release", "nutrients"}
    (change,) = staff.get("/v1/foods/apple/changes").json()["items"]
    assert change["differences"] == {
        "name": ["Apple, raw, with skin", "Apple of our orchard"],
        "nutrients.401": [4.6, 12.0],
    }
    assert (change["version"], change["previous_version"]) == (2, 1)
    assert change["previous_release"] == before["release"]


def test_null_takes_a_figure_away_which_is_unknown_and_not_zero(staff):
    assert "401" in staff.nutrients("apple")
    assert staff.patch("apple", nutrients={"401": None, "CAFFN": None}).status_code == 200
    nutrients = staff.nutrients("apple")
    assert "401" not in nutrients
    assert "262" not in nutrients


def test_a_patch_that_changes_nothing_makes_no_version(staff):
    done = staff.patch("apple", form="whole")
    assert (done.status_code, done.json()["version"]) == (200, 1)
    assert staff.get("/v1/foods/apple/changes").json()["items"] == []


def test_an_edit_copies_the_foods_own_densities_not_those_pooled_from_other_tables(staff, state):
    from app.db.models import FoodDensity
    from app.db.queries import foods

    def own():
        with state.database.read() as session:
            food = foods.foods_by_key(session, ["apple"])["apple"]
            return [row.source for row in session.query(FoodDensity).filter_by(food_id=food.id)]

    before = own()
    staff.patch("apple", name="another name")
    assert own() == before


def test_a_corrected_density_is_not_undone_by_the_row_that_it_corrects(staff):
    density = {"g_per_ml": 0.9, "sd_g_per_ml": 0.02, "state": "raw", "kind": "solid", "source": "ours"}
    assert staff.patch("apple", densities=[density]).status_code == 200
    choice = staff.get("/v1/foods/apple").json()["density"]
    assert choice["chosen"]["g_per_ml"] == 0.9
    assert not any(other["source"].startswith("ECUSTFD") for other in choice["alternatives"])


def test_the_tag_is_asked_for_and_must_be_the_one_in_force(staff, client, admin):
    body = {"name": "x", "reason": "y"}
    refused(client.patch("/v1/foods/apple", headers=admin, json=body), 428, "precondition_required")
    tag = staff.get("/v1/foods/apple").headers["etag"]
    assert staff.patch("apple", tag, name="first").status_code == 200
    assert refused(staff.patch("apple", tag, name="second"), 412, "food_changed_since")["version"] == 2
    for wrong in ('""', "W/" + tag, "apple", '"-1"', '"' + "9" * 400 + '"', '"1e3"', "\x7f"):
        refused(staff.patch("apple", wrong, name="third"), 412, "food_changed_since")
    now = staff.get("/v1/foods/apple").headers["etag"]
    assert staff.patch("apple", f'"0", {now}', name="fourth").status_code == 200
    assert staff.patch("apple", "*", name="fifth").status_code == 200


def test_of_corrections_at_the_same_time_one_wins(staff):
    tag = staff.get("/v1/foods/banana").headers["etag"]
    answers = at_once(6, lambda n: staff.patch("banana", tag, name=f"banana {n}"))
    assert sorted(answer.status_code for answer in answers) == [200, 412, 412, 412, 412, 412]
    winner = next(answer for answer in answers if answer.status_code == 200)
    assert staff.get("/v1/foods/banana").json() == winner.json()
    assert len(staff.get("/v1/foods/banana/changes").json()["items"]) == 1


def test_of_the_same_food_made_at_the_same_time_one_is_made(staff):
    answers = at_once(6, lambda n: staff.food(name=f"Quark {n}"))
    assert sorted(answer.status_code for answer in answers) == [201, 409, 409, 409, 409, 409]


def test_densities_added_at_the_same_time_are_all_kept(staff):
    def add(n):
        body = {"g_per_ml": 0.5 + n / 100, "sd_g_per_ml": 0.01, "state": "raw", "kind": "solid"}
        return staff.post("/v1/foods/banana/densities", body | {"method": f"scale {n}", "reason": "measured"})

    answers = at_once(4, add)
    assert [answer.status_code for answer in answers] == [201] * 4, [answer.json() for answer in answers]
    choice = staff.get("/v1/foods/banana").json()["density"]
    found = {choice["chosen"]["source"], *(other["source"] for other in choice["alternatives"])}
    assert {f"scale {n}" for n in range(4)} <= found


def at_once(count, call):
    answers, gate = [None] * count, threading.Barrier(count)

    def run(n):
        gate.wait()
        answers[n] = call(n)

    threads = [threading.Thread(target=run, args=(n,)) for n in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers


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


def test_a_measured_density_goes_before_the_tables(staff):
    specimens = [{"volume_ml": 200, "mass_g": 168}, {"volume_ml": 250, "mass_g": 204}, {"volume_ml": 100, "mass_g": 82}]
    body = {
        "specimens": specimens,
        "volume_step_ml": 10,
        "state": "raw, whole",
        "kind": "solid",
        "method": "water",
        "reason": "r",
    }
    made = staff.post("/v1/foods/apple/densities", body)
    assert made.status_code == 201, made.json()
    chosen = made.json()["density"]["chosen"]
    assert (chosen["g_per_ml"], chosen["basis"], chosen["source"]) == (0.82, "measured", "water: median of 3 specimens")
    assert chosen["sd_g_per_ml"] == pytest.approx(10 / 12**0.5 / (550 / 3) * 0.82)


def test_a_study_s_own_density_goes_first_there_and_nowhere_else(staff, enrol):
    phone, other = enrol("P001", "pilot"), enrol("P002", "second")
    body = {"food": "09003", "g_per_ml": 0.7, "sd_g_per_ml": 0.02, "state": "raw", "kind": "solid"}
    body |= {"method": "water displacement", "reason": "our cultivar"}
    made = staff.post("/v1/studies/pilot/densities", body)
    assert made.status_code == 201, made.json()
    assert made.json()["food"] == "apple"
    chosen = phone.get("/v1/foods/apple").json()["density"]["chosen"]
    assert (chosen["g_per_ml"], chosen["basis"]) == (0.7, "study")
    assert other.get("/v1/foods/apple").json()["density"]["chosen"]["basis"] == "measured"
    assert staff.get("/v1/foods/apple").json()["density"]["chosen"]["basis"] == "measured"
    path = f"/v1/studies/pilot/densities/{made.json()['id']}/withdrawal"
    refused(staff.post(path.replace("pilot", "second"), {"reason": "not ours"}), 404, "density_not_found")
    withdrawn = staff.post(path, {"reason": "scale was off"})
    assert withdrawn.json()["withdrawal_reason"] == "scale was off"
    refused(staff.post(path, {"reason": "again"}), 409, "density_withdrawn")
    assert phone.get("/v1/foods/apple").json()["density"]["chosen"]["basis"] == "measured"
    listed = staff.get("/v1/studies/pilot/densities?food=apple").json()["items"]
    assert [row["withdrawn_by"] for row in listed] == ["staff: admin"]
    assert staff.get("/v1/studies/second/densities").json() == {"items": []}


def test_specimens_of_a_study_s_density_are_kept(staff, enrol):
    enrol()
    specimens = [{"volume_ml": 200.0, "mass_g": 168.0}, {"volume_ml": 250.0, "mass_g": 204.0}]
    body = {"food": "apple", "specimens": specimens, "state": "raw", "kind": "solid", "method": "m", "reason": "r"}
    made = staff.post("/v1/studies/pilot/densities", body | {"measured_at": "2026-11-20T12:00:00+08:00"}).json()
    assert made["specimens"] == specimens
    assert made["g_per_ml"] == pytest.approx((0.84 + 0.816) / 2)
    assert made["measured_at"] == "2026-11-20T04:00:00Z"


@pytest.mark.parametrize(
    "change",
    [
        {"g_per_ml": 0.7},
        {"sd_g_per_ml": 0.1},
        {"specimens": []},
        {"specimens": [{"volume_ml": 1, "mass_g": 1}]},
        {"specimens": [{"volume_ml": 10, "mass_g": 100}] * 2},
        {"specimens": [{"volume_ml": 0, "mass_g": 1}] * 2},
        {"specimens": [{"volume_ml": 1e6, "mass_g": 1e-320}] * 2},
        {"specimens": [{"volume_ml": 1e6, "mass_g": 0.01}] * 2},
        {
            "specimens": [
                {"volume_ml": 100, "mass_g": 1},
                {"volume_ml": 100, "mass_g": 290},
                {"volume_ml": 100, "mass_g": 9},
            ]
        },
        {"specimens": [{"volume_ml": 1, "mass_g": 1}] * 2, "volume_step_ml": 100},
        {"g_per_ml": 0.1, "sd_g_per_ml": 0.2},
        {"g_per_ml": 1e-320, "sd_g_per_ml": 0.0},
        {"specimens": [{"volume_ml": 10, "mass_g": 9}] * 2, "g_per_ml": 1.0, "sd_g_per_ml": 0.1},
        {"g_per_ml": 9.0, "sd_g_per_ml": 0.1},
        {"g_per_ml": 1.0, "sd_g_per_ml": -0.1},
        {"g_per_ml": 1.0, "sd_g_per_ml": 0.1, "kind": "fluffy"},
        {"g_per_ml": 1.0, "sd_g_per_ml": 0.1, "measured_at": "2999-01-01T00:00:00Z"},
        {"g_per_ml": 1.0, "sd_g_per_ml": 0.1, "measured_at": "2026-01-01T00:00:00"},
        {"g_per_ml": True, "sd_g_per_ml": 0.1},
        {"g_per_ml": "1", "sd_g_per_ml": 0.1},
    ],
)
def test_a_density_that_cannot_be_is_refused(staff, enrol, change):
    enrol()
    body = {"food": "apple", "state": "raw", "kind": "solid", "method": "m", "reason": "r"} | change
    assert staff.post("/v1/studies/pilot/densities", body).status_code == 422
    assert staff.get("/v1/studies/pilot/densities").json() == {"items": []}


def test_only_an_admin_edits(client, phone):
    calls = [
        ("POST", "/v1/foods", QUARK),
        ("PATCH", "/v1/foods/apple", {"name": "x", "reason": "y"}),
        ("POST", "/v1/foods/apple/densities", {}),
        ("POST", "/v1/foods/apple/restore", {"version": 1, "reason": "y"}),
        ("GET", "/v1/foods/apple/changes", None),
        ("POST", "/v1/studies/pilot/densities", {}),
        ("GET", "/v1/studies/pilot/densities", None),
    ]
    for method, path, body in calls:
        assert client.request(method, path, json=body).status_code == 401, path
        answer = client.request(method, path, json=body, headers=phone.headers | {"If-Match": "*"})
        assert (answer.status_code, answer.json()["code"]) == (403, "admin_only"), path


@pytest.mark.parametrize(
    ("nutrients", "code"),
    [
        ({"VITX": {"per_100_g": 1, "unit": "mg"}}, "component_unknown"),
        ({"ENERC_KCAL": {"per_100_g": 50, "unit": "g"}}, "unit_differs"),
        ({"VITC": {"per_100_g": 5, "unit": "IU"}}, "unit_differs"),
        ({"VITC": {"per_100_g": 5, "unit": "mg"}, "401": {"per_100_g": 6, "unit": "mg"}}, "component_repeated"),
        ({"PROCNT": {"per_100_g": 60, "unit": "g"}, "FAT": {"per_100_g": 60, "unit": "g"}}, "figures_impossible"),
        ({"NA": {"per_100_g": 101, "unit": "g"}}, "figures_impossible"),
        ({"ENERC_KCAL": {"per_100_g": 2000, "unit": "kcal"}}, "figures_impossible"),
    ],
)
def test_figures_that_cannot_be_are_refused(staff, nutrients, code):
    refused(staff.food(nutrients=nutrients), 422, code)
    refused(staff.patch("apple", nutrients=nutrients), 422, code)
    assert staff.get("/v1/foods/quark-low-fat").status_code == 404
    assert staff.get("/v1/foods/apple").json()["version"] == 1


def test_an_unknown_component_is_named(staff):
    body = staff.food(nutrients={"VITX": {"per_100_g": 1, "unit": "mg"}}).json()
    assert body["component"] == "VITX"
    assert "VITX" in body["detail"]


@pytest.mark.parametrize(
    "change",
    [
        {"name": ""},
        {"name": "  "},
        {"name": "x" * 301},
        {"name": "a\0b"},
        {"name": 5},
        {"name": ["x"]},
        {"key": "Apple"},
        {"key": "09003"},
        {"key": "a/b"},
        {"key": "../x"},
        {"key": "a\n"},
        {"key": "x" * 101},
        {"form": "cube"},
        {"state": "burnt"},
        {"group": None},
        {"reason": None},
        {"reason": ""},
        {"reason": "\t"},
        {"unknown_field": 1},
        {"is_mixed_dish": "yes"},
        {"refuse": [{"part": "peel", "percent": 60}, {"part": "core", "percent": 40}]},
        {"refuse": [{"part": "peel", "percent": 10}, {"part": "peel", "percent": 10}]},
        {"refuse": [{"part": "peel", "percent": -1}]},
        {"portions": [{"amount": 1, "measure": "cup", "mass_g": 0}]},
        {"densities": [{"g_per_ml": 0, "sd_g_per_ml": 0, "state": "x", "kind": "solid", "source": "x"}]},
        {"nutrients": {"VITC": {"per_100_g": -1, "unit": "mg"}}},
        {"nutrients": {"VITC": {"per_100_g": 1e308, "unit": "mg"}}},
        {"nutrients": {"VITC": {"per_100_g": True, "unit": "mg"}}},
        {"nutrients": {"VITC": {"per_100_g": "5", "unit": "mg"}}},
        {"nutrients": {"VITC": {"per_100_g": None, "unit": "mg"}}},
        {"nutrients": {"VITC": None}},
        {"nutrients": {"VITC": 5}},
        {"nutrients": {"VITC": {"per_100_g": 5, "unit": "lb"}}},
        {"nutrients": {"\0": {"per_100_g": 5, "unit": "mg"}}},
        {"nutrients": []},
        {"aliases": ["x"] * 101},
        {"source_ids": {"A B": "1"}},
        {"source_ids": {"sr28_ndb": ""}},
        {"probes": ["DROP TABLE"]},
    ],
    ids=str,
)
def test_what_a_food_cannot_be_is_refused(staff, change):
    answer = staff.food(**change)
    assert answer.status_code == 422, answer.json()
    assert answer.json()["code"] in {"invalid_input", "food_invalid"}
    assert staff.get("/v1/foods?q=quark low").json()["items"][:1] != [{"key": "quark-low-fat"}]


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"{",
        b"null",
        b"[]",
        b'"food"',
        b"\xff\xfe",
        b'{"nutrients": {"VITC": {"per_100_g": NaN, "unit": "mg"}}, "reason": "r"}',
        b'{"nutrients": {"VITC": {"per_100_g": 1e999, "unit": "mg"}}, "reason": "r"}',
        b'{"nutrients": {"VITC": {"per_100_g": -Infinity, "unit": "mg"}}, "reason": "r"}',
        b'{"name": "\\ud800", "reason": "r"}',
        b'{"name": "x", "reason": "\\udfff"}',
        b'{"nutrients": {"\\ud800": null}, "reason": "r"}',
        b'{"\\ud800": null, "reason": "r"}',
        b'{"a":' * 5000 + b"1" + b"}" * 5000,
        b"[" * 100_000,
        b'{"reason": "r", "nutrients": ' + b'{"x":' * 50_000 + b"1" + b"}" * 50_000 + b"}",
    ],
    ids=lambda raw: raw[:40].decode("latin-1"),
)
def test_broken_bodies_are_refused_and_change_nothing(staff, client, admin, raw):
    headers = admin | {"If-Match": "*", "Content-Type": "application/json"}
    for method, path in [("PATCH", "/v1/foods/apple"), ("POST", "/v1/foods"), ("POST", "/v1/foods/apple/densities")]:
        answer = client.request(method, path, headers=headers, content=raw)
        assert 400 <= answer.status_code < 500, answer.text
        assert answer.json()["code"]
    assert staff.get("/v1/foods/apple").json()["version"] == 1


def test_a_huge_body_is_refused_before_it_is_read(staff):
    answer = staff.food(aliases=["x" * 299] * 2000)
    refused(answer, 413, "too_large")


def test_formulas_markup_and_any_script_are_kept_as_they_are(staff):
    names = [
        '=HYPERLINK("http://x","y")',
        "<script>alert(1)</script>",
        "Ⅷ 苹果 🍎 e\u0301",
        "'; DROP TABLE food; --",
        "%_\\",
    ]
    made = staff.food(name=names[1], aliases=names, reason=names[0])
    assert made.status_code == 201, made.json()
    food = staff.get("/v1/foods/quark-low-fat").json()
    assert (food["name"], food["aliases"]) == (names[1], names)


def test_a_correction_survives_a_new_release_of_its_table(staff, state):
    from dataclasses import replace
    from datetime import date

    from app.nutrition.components import COMPONENT_BY_NUMBER
    from app.nutrition.foods import load_starter_table
    from app.nutrition.importers.imported import ImportedTable, Skipped

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
    from app.services.food_releases import use_release

    staff.food()
    use_release(state.database, "local", None, author="a test")
    refused(staff.patch("apple", name="x"), 409, "local_foods_off")
    use_release(state.database, "local", "1", author="a test")
    assert staff.patch("apple", name="x").status_code == 200


SALAD = {
    "key": "fruit-salad-ours",
    "name": "Fruit salad",
    "group": "Mixed",
    "form": "heap",
    "state": None,
    "nutrients": None,
    "densities": None,
}


def apple(mass_g=100.0, **more):
    return {"food": "apple", "mass_g": mass_g, "state": "raw"} | more


def test_a_dish_has_the_figures_of_its_recipe_and_shows_it(staff):
    recipe = {
        "yield_factor": 0.8,
        "ingredients": [
            apple(200.0, retention={"VITC": 0.5}, retention_source="a made-up factor for this test"),
            {"food": "banana", "mass_g": 100.0, "state": "raw"},
        ],
    }
    made = staff.food(**SALAD, recipe=recipe)
    assert made.status_code == 201, made.json()
    body = made.json()
    assert (body["is_mixed_dish"], body["state"]) == (True, "as_eaten")
    assert body["density"] is None
    raw_apple, raw_banana, dish = (staff.nutrients(key) for key in ("apple", "banana", "fruit-salad-ours"))
    assert dish["306"] == pytest.approx((2 * raw_apple["306"] + raw_banana["306"]) / 2.4)
    assert dish["401"] == pytest.approx((raw_apple["401"] + raw_banana["401"]) / 2.4)
    assert dish["255"] == pytest.approx((2 * raw_apple["255"] + raw_banana["255"] - 60.0) / 2.4)
    shown = body["recipe"]
    assert shown["yield_factor"] == 0.8
    assert [part["key"] for part in shown["ingredients"]] == ["apple", "banana"]
    assert shown["ingredients"][0]["retention"] == {"401": 0.5}
    lacking = (raw_apple.keys() ^ raw_banana.keys()) & (raw_apple.keys() | raw_banana.keys())
    assert {row["number"] for row in shown["unknown"]} == lacking
    assert not lacking & dish.keys()
    assert all(row["coverage"] in (pytest.approx(1 / 3), pytest.approx(2 / 3)) for row in shown["unknown"])


def test_a_dish_keeps_the_versions_that_it_was_made_of_until_its_recipe_is_given_again(staff):
    recipe = {"yield_factor": 1.0, "ingredients": [apple()]}
    staff.food(**SALAD, recipe=recipe)
    was = staff.nutrients("fruit-salad-ours")
    staff.patch("apple", nutrients={"VITC": {"per_100_g": 99, "unit": "mg"}})
    assert staff.nutrients("fruit-salad-ours") == was
    (part,) = staff.get("/v1/foods/fruit-salad-ours").json()["recipe"]["ingredients"]
    assert (part["version"], part["is_current"]) == (1, False)
    renamed = staff.patch("fruit-salad-ours", name="Salad").json()
    assert renamed["recipe"]["ingredients"] == [part]
    again = staff.patch("fruit-salad-ours", recipe=recipe).json()
    assert again["recipe"]["ingredients"][0]["is_current"] is True
    assert staff.nutrients("fruit-salad-ours")["401"] == pytest.approx(99.0)


def test_figures_of_a_dish_follow_from_its_recipe_unless_it_is_taken_away(staff):
    recipe = {"yield_factor": 1.0, "ingredients": [apple()]}
    figure = {"VITC": {"per_100_g": 1, "unit": "mg"}}
    refused(staff.food(**SALAD | {"nutrients": figure}, recipe=recipe), 422, "nutrients_of_recipe")
    staff.food(**SALAD, recipe=recipe)
    refused(staff.patch("fruit-salad-ours", nutrients=figure), 422, "nutrients_of_recipe")
    done = staff.patch("fruit-salad-ours", nutrients=figure, recipe=None)
    assert done.json()["recipe"] is None
    assert staff.nutrients("fruit-salad-ours")["401"] == 1.0
    tag = done.headers["etag"]
    back = staff.post("/v1/foods/fruit-salad-ours/restore", {"version": 1, "reason": "r"}, **{"If-Match": tag}).json()
    assert back["recipe"]["ingredients"][0]["key"] == "apple"


def test_dishes_nest_and_never_contain_themselves(staff):
    inner = SALAD | {"key": "compote-ours"}
    assert staff.food(**inner, recipe={"yield_factor": 1.0, "ingredients": [apple()]}).status_code == 201
    of_compote = {"food": "compote-ours", "mass_g": 50.0, "state": "as_eaten"}
    outer = staff.food(**SALAD, recipe={"yield_factor": 1.0, "ingredients": [of_compote, of_compote]})
    assert outer.status_code == 201, outer.json()
    assert staff.nutrients("fruit-salad-ours") == pytest.approx(staff.nutrients("apple"))
    of_salad = {"food": "fruit-salad-ours", "mass_g": 50.0, "state": "as_eaten"}
    recipe = {"yield_factor": 1.0, "ingredients": [of_salad]}
    body = refused(staff.patch("compote-ours", recipe=recipe), 422, "recipe_cycle")
    assert body["way"] == ["compote-ours", "fruit-salad-ours", "compote-ours"]
    recipe = {"yield_factor": 1.0, "ingredients": [of_compote]}
    refused(staff.patch("compote-ours", recipe=recipe), 422, "recipe_cycle")


@pytest.mark.parametrize(
    ("recipe", "code"),
    [
        ({"yield_factor": 1.0, "ingredients": [apple(state="cooked")]}, "ingredient_state_differs"),
        ({"yield_factor": 1.0, "ingredients": [apple(food="no-such-food")]}, "ingredient_unknown"),
        ({"yield_factor": 0.1, "ingredients": [apple()]}, "recipe_impossible"),
        (
            {"yield_factor": 1.0, "ingredients": [apple(retention={"VITX": 0.5}, retention_source="s")]},
            "component_unknown",
        ),
        (
            {"yield_factor": 1.0, "ingredients": [apple(retention={"ENERC_KCAL": 0.5}, retention_source="s")]},
            "retention_invalid",
        ),
        ({"yield_factor": 1.0, "ingredients": [apple(retention={"VITC": 0.5})]}, "invalid_input"),
        ({"yield_factor": 1.0, "ingredients": [apple(retention={"VITC": 1.5}, retention_source="s")]}, "invalid_input"),
        ({"yield_factor": 1.0, "ingredients": []}, "invalid_input"),
        ({"yield_factor": 0, "ingredients": [apple()]}, "invalid_input"),
        ({"yield_factor": 1.0, "ingredients": [apple(mass_g=-1)]}, "invalid_input"),
        ({"yield_factor": 1.0, "ingredients": [apple(mass_g=1e308)]}, "invalid_input"),
        ({"yield_factor": 1.0, "ingredients": [{"food": "apple", "mass_g": 1.0}]}, "invalid_input"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_recipe_that_cannot_be_is_refused(staff, recipe, code):
    refused(staff.food(**SALAD, recipe=recipe), 422, code)
    assert staff.get("/v1/foods/fruit-salad-ours").status_code == 404


def test_the_document_tells_of_every_call(client):
    paths = json.loads(client.get("/openapi.json").text)["paths"]
    assert "428" in paths["/v1/foods/{key}"]["patch"]["responses"]
    assert "post" in paths["/v1/studies/{study}/densities/{density}/withdrawal"]
