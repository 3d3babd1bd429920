"""Recipes: known truths, balance of mass, scaling, nesting, and what is refused."""

import math
from dataclasses import replace

import pytest

from app.core.errors import InvalidInputError
from app.nutrition.components import NUMBER_BY_TAGNAME
from app.nutrition.foods import Food, load_starter_table
from app.nutrition.plausible import why_impossible
from app.nutrition.recipe import Ingredient, cycle_through, prepare_dish

N = NUMBER_BY_TAGNAME


def food(key, state="raw", **contents):
    """A food of these contents by tagname."""
    return Food(
        key=key,
        name=key,
        aliases=(),
        food_group="test",
        form="heap",
        slice_form=None,
        refuse=(),
        densities=(),
        per_100_g={N[tagname]: content for tagname, content in contents.items()},
        source_ids={},
        state=state,
    )


POTATO = food("potato", WATER=79.0, PROCNT=2.0, FAT=0.1, CHOCDF=17.5, ASH=1.1, ENERC_KCAL=77.0, VITC=20.0, K=425.0)
MINCE = food("mince", WATER=60.0, PROCNT=18.0, FAT=20.0, CHOCDF=0.0, ASH=1.0, ENERC_KCAL=254.0, FASAT=8.0, CHOLE=70.0)
WINE = food("wine", "as_eaten", WATER=86.0, PROCNT=0.1, FAT=0.0, CHOCDF=2.6, ALC=10.6, ASH=0.3, ENERC_KCAL=85.0)


def part(food, mass_g=100.0, state=None, **retention):
    return Ingredient(food, mass_g, state or food.state, {N[tagname]: share for tagname, share in retention.items()})


def dish(*ingredients, y=1.0):
    return {
        tagname: content
        for number, content in prepare_dish(ingredients, y).per_100_g.items()
        for tagname in [next(name for name, n in N.items() if n == number)]
    }


def test_yield_and_retention_of_one_ingredient_are_taken_off_and_concentrate_the_rest():
    assert prepare_dish([part(POTATO, 250.0)], 1.0).per_100_g == pytest.approx(dict(POTATO.per_100_g))
    baked = dish(part(POTATO, VITC=0.75), y=0.8)
    assert baked["WATER"] == pytest.approx((79.0 - 20.0) / 0.8)
    assert baked["VITC"] == pytest.approx(20.0 * 0.75 / 0.8)
    assert baked["K"] == pytest.approx(425.0 / 0.8)
    assert baked["ENERC_KCAL"] == pytest.approx(77.0 / 0.8)
    rice = food("rice", WATER=12.0, CHOCDF=80.0, PROCNT=7.0, FAT=0.5, ASH=0.5)
    boiled = dish(part(rice), y=2.8)
    assert boiled["WATER"] == pytest.approx((12.0 + 180.0) / 2.8)
    assert boiled["CHOCDF"] == pytest.approx(80.0 / 2.8)


def test_fat_that_drips_off_takes_its_fatty_acids_and_its_energy_with_it_and_is_not_counted_as_water():
    fried = dish(part(MINCE, FAT=0.6), y=0.7)
    assert fried["FAT"] == pytest.approx(20.0 * 0.6 / 0.7)
    assert fried["FASAT"] == pytest.approx(8.0 * 0.6 / 0.7)
    assert fried["CHOLE"] == pytest.approx(70.0 / 0.7)
    assert fried["ENERC_KCAL"] == pytest.approx((254.0 - 8.0 * 9.0) / 0.7)
    assert fried["WATER"] == pytest.approx((60.0 - 30.0 + 8.0) / 0.7)


def test_alcohol_that_boils_off_takes_its_energy_which_is_unknown_where_what_is_lost_is():
    reduced = dish(part(WINE, ALC=0.25), y=0.5)
    assert reduced["ALC"] == pytest.approx(10.6 * 0.25 / 0.5)
    assert reduced["ENERC_KCAL"] == pytest.approx((85.0 - 10.6 * 0.75 * 7.0) / 0.5)
    lard = food("lard", ENERC_KCAL=900.0, WATER=0.0)
    assert "ENERC_KCAL" not in dish(part(lard, FAT=0.5))
    own_factor = dish(part(MINCE, FAT=0.5, FASAT=1.0), y=0.8)
    assert own_factor["FASAT"] == pytest.approx(8.0 / 0.8)  # which goes before that of the fat


def test_a_component_that_one_ingredient_lacks_is_unknown_for_the_dish_and_its_coverage_told():
    made = prepare_dish([part(POTATO, 300.0), part(MINCE, 100.0)], 1.0)
    assert N["VITC"] not in made.per_100_g
    assert made.coverage[N["VITC"]] == pytest.approx(0.75)
    assert made.coverage[N["FAT"]] == 1.0
    assert N["CA"] not in made.coverage
    assert dish(part(MINCE), part(WINE))["CHOCDF"] == pytest.approx(1.3)


def refusal(ingredients, y=1.0):
    with pytest.raises(InvalidInputError) as caught:
        prepare_dish(ingredients, y)
    return caught.value.code


COOKED = replace(POTATO, state="cooked")


@pytest.mark.parametrize(
    ("ingredient", "y", "code"),
    [
        (part(POTATO, state="cooked"), 1.0, "ingredient_state_differs"),
        (part(COOKED, state="raw"), 1.0, "ingredient_state_differs"),
        (part(replace(POTATO, state=None), state="raw"), 1.0, "ingredient_state_differs"),
        (part(COOKED, VITC=0.8), 1.0, "ingredient_is_cooked"),
        (part(COOKED), 0.8, "ingredient_is_cooked"),
        (part(POTATO, WATER=0.9), 1.0, "retention_invalid"),  # follows from the rest
        (part(POTATO, ENERC_KCAL=0.9), 1.0, "retention_invalid"),
        (part(POTATO, ENERC_KJ=0.9), 1.0, "retention_invalid"),
        (part(POTATO), 0.2, "recipe_impossible"),  # takes more water than there is
    ],
)
def test_ingredient_that_does_not_fit_its_recipe_is_refused(ingredient, y, code):
    assert refusal([ingredient], y) == code


@pytest.mark.parametrize("figure", [0.0, -1.0, math.nan, math.inf])
def test_a_yield_a_mass_or_a_share_that_cannot_be_and_no_ingredients_are_errors(figure):
    with pytest.raises(ValueError, match="a yield"):
        prepare_dish([part(POTATO)], figure)
    with pytest.raises(ValueError, match="a mass"):
        prepare_dish([part(POTATO, figure)], 1.0)
    with pytest.raises(ValueError, match="share"):
        prepare_dish([part(POTATO, VITC=1.01)], 1.0)
    with pytest.raises(ValueError, match="ingredients"):
        prepare_dish([], 1.0)


def test_a_dish_that_contains_itself_is_found_with_the_way_there():
    parts = {"stew": ["sauce"], "sauce": ["stock", "salt"], "stock": ["stew"]}
    assert cycle_through("stew", ["sauce"], parts) == ["stew", "sauce", "stock", "stew"]
    assert cycle_through("soup", ["sauce"], parts) is None
    assert cycle_through("stew", ["stew"], {}) == ["stew", "stew"]


@pytest.mark.parametrize(
    ("contents", "said"),
    [
        ({"WATER": 60.0, "PROCNT": 30.0, "FAT": 20.0}, "add up"),
        ({"CHOAVL": 90.0, "WATER": 20.0}, "add up"),
        ({"NA": 100_001.0}, "sodium"),
        ({"ENERC_KCAL": 2000.0}, "pure fat"),
        ({"ENERC_KJ": 4000.0}, "pure fat"),
    ],
)
def test_figures_that_no_food_has_are_told_and_the_starter_table_has_none(contents, said):
    assert said in why_impossible({N[tagname]: content for tagname, content in contents.items()})
    assert [f.key for f in load_starter_table().foods if why_impossible(f.per_100_g)] == []
