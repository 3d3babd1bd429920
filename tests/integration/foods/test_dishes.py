"""Dishes made from recipes over HTTP: their figures, what they are pinned to, what is refused."""

import pytest

from tests.integration.foods.editing import refused

SALAD = {"key": "fruit-salad-ours", "name": "Fruit salad", "group": "Mixed", "form": "heap"}
SALAD |= {"state": None, "nutrients": None, "densities": None}


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


def test_a_recipe_that_cannot_be_is_refused(staff):
    for ingredient, code in (
        (apple(state="cooked"), "ingredient_state_differs"),
        (apple(food="no-such-food"), "ingredient_unknown"),
        (apple(retention={"VITX": 0.5}, retention_source="s"), "component_unknown"),
        (apple(retention={"ENERC_KCAL": 0.5}, retention_source="s"), "retention_invalid"),
        (apple(retention={"VITC": 0.5}), "invalid_input"),
        (apple(retention={"VITC": 1.5}, retention_source="s"), "invalid_input"),
        (apple(mass_g=-1), "invalid_input"),
        (apple(mass_g=1e308), "invalid_input"),
        ({"food": "apple", "mass_g": 1.0}, "invalid_input"),
    ):
        refused(staff.food(**SALAD, recipe={"yield_factor": 1.0, "ingredients": [ingredient]}), 422, code)
    for yield_factor, ingredients, code in (
        (0.1, [apple()], "recipe_impossible"),
        (0, [apple()], "invalid_input"),
        (1.0, [], "invalid_input"),
    ):
        refused(staff.food(**SALAD, recipe={"yield_factor": yield_factor, "ingredients": ingredients}), 422, code)
    assert staff.get("/v1/foods/fruit-salad-ours").status_code == 404
