"""Foods in the groups that recommendations speak of: the traps of SR28's own groups, and no gram lost."""

import math
from dataclasses import replace

import pytest

from app.nutrition.foods import load_starter_table
from app.nutrition.intakes.food_groups import (
    FOOD_GROUPS,
    Eaten,
    GroupTotals,
    classify,
    compare,
    food_group_of,
    recommendations,
    total_groups,
)
from tests.unit.nutrition.make_food import make_food

FRUIT, VEGETABLES = "Fruits and Fruit Juices", "Vegetables and Vegetable Products"
LEGUMES, DAIRY = "Legumes and Legume Products", "Dairy and Egg Products"


@pytest.mark.parametrize(
    ("source_group", "name", "group"),
    [
        (FRUIT, "Apples, raw, with skin", "fruit"),
        (FRUIT, "Orange juice, raw", "fruit_juice"),
        (VEGETABLES, "Potatoes, baked, flesh and skin, without salt", "starchy_tubers"),
        (VEGETABLES, "Sweet potato leaves, raw", "vegetables"),
        (VEGETABLES, "Potatoes, au gratin, home-prepared from recipe using butter", None),
        (VEGETABLES, "Tomatoes, red, ripe, canned, packed in tomato juice", "vegetables"),
        (LEGUMES, "Peanut butter, smooth style, with salt", "nuts"),
        (LEGUMES, "MORI-NU, Tofu, silken, firm", "soy"),
        (LEGUMES, "Soy sauce made from soy (tamari)", None),
        (DAIRY, "Milk, whole, 3.25% milkfat, with added vitamin D", "milk"),
        (DAIRY, "Butter, salted", "dairy_fat"),
        (DAIRY, "Eggnog", None),
        ("Pork Products", "Pork, cured, bacon, unprepared", "processed_meat"),
        ("Poultry Products", "Chicken, skin (drumsticks and thighs), raw", "poultry"),
        ("Finfish and Shellfish Products", "Mollusks, clam, mixed species, cooked, breaded and fried", None),
        ("Fats and Oils", "Oil, palm", "palm_oil"),
        ("Baked Products", "Doughnuts, yeast-leavened, glazed, enriched (includes honey buns)", None),
        ("A group of another table", "Apples, raw", None),
    ],
)
def test_a_food_is_in_the_group_that_a_dietitian_would_name(source_group, name, group):
    assert classify(source_group, name) == group


def test_starter_foods_are_placed_by_the_name_that_sr28_gives_them_and_a_mixed_dish_in_no_group():
    placed = {food.key: food_group_of(food) for food in load_starter_table().foods}
    assert (placed["apple"], placed["potato-mashed"], placed["orange-juice"]) == (
        "fruit",
        "starchy_tubers",
        "fruit_juice",
    )
    assert placed["bread-white"] == "grains"
    assert placed["cornflakes"] is None  # sweetened, although its own name does not say so
    assert placed["lasagna"] is None
    dish = replace(make_food(), food_group=VEGETABLES, name="Carrots, cooked", is_mixed_dish=True)
    assert food_group_of(dish) is None


def eaten(key, group, name, edible_g):
    return Eaten(replace(make_food(key=key), food_group=group, name=name), edible_g)


APPLE = eaten("apple", FRUIT, "Apples, raw", 150.0)
CARROT = eaten("carrot", VEGETABLES, "Carrots, raw", 250.0)
LASAGNA = eaten("lasagna", "Meals, Entrees, and Side Dishes", "Lasagna", 100.0)
UNKNOWN = eaten("soup", "Soups, Sauces, and Gravies", "Soup", None)


def test_every_gram_is_in_a_group_or_unassigned_and_no_known_mass_has_no_share():
    totals = total_groups([APPLE, APPLE, CARROT, LASAGNA, UNKNOWN])
    assert totals.grams == {"fruit": 300.0, "vegetables": 250.0}
    assert totals.unassigned_g == {"lasagna": 100.0}
    assert totals.unassigned_share == pytest.approx(100.0 / 650.0)
    assert totals.unmeasured == 1
    assert total_groups([UNKNOWN]).unassigned_share is None


def fruit_and_vegetables(age_years=30):
    return next(found for found in recommendations(age_years) if found.name == "Vegetables and fruits")


@pytest.mark.parametrize(
    ("meals", "days", "verdict"),
    [
        ([APPLE, CARROT], 1, "met"),
        ([APPLE, CARROT], 2, "not_met"),
        ([APPLE, APPLE, LASAGNA], 1, "open"),
        ([APPLE, LASAGNA], 1, "not_met"),
        ([APPLE, UNKNOWN], 1, "open"),
        ([APPLE, CARROT, LASAGNA, UNKNOWN], 1, "met"),
    ],
)
def test_a_least_amount_is_met_only_if_no_unassigned_gram_could_change_it(meals, days, verdict):
    assert compare(total_groups(meals), fruit_and_vegetables(), days).verdict == verdict


@pytest.mark.parametrize(
    ("grams", "unassigned", "verdict"),
    [(10.0, 0.0, "met"), (10.0, 10.0, "open"), (15.0, 0.0, "not_met"), (15.0, 99.0, "not_met")],
)
def test_a_most_amount_is_met_only_if_no_unassigned_gram_could_pass_it(grams, unassigned, verdict):
    pork = next(found for found in recommendations(30) if found.name == "Pork")
    assert compare(GroupTotals({"pork": grams}, {"x": unassigned}, 0), pork, 1).verdict == verdict


def test_potatoes_and_juice_do_not_count_as_vegetables_and_fruit_nor_dry_weights_as_cooked():
    potato = eaten("potato", VEGETABLES, "Potatoes, boiled", 500.0)
    juice = eaten("juice", FRUIT, "Orange juice, raw", 500.0)
    found = compare(total_groups([potato, juice]), fruit_and_vegetables(), 1)
    assert (found.grams_per_day, found.verdict) == (0.0, "not_met")
    lentils = eaten("lentils", LEGUMES, "Lentils, cooked, boiled", 50.0)
    dry = next(found for found in recommendations(30) if found.groups == ("legumes",))
    found = compare(total_groups([lentils]), dry, 1)
    assert (found.grams_per_day, found.verdict) == (50.0, "open")
    assert "grams dry" in found.reason


@pytest.mark.parametrize("days", [0.0, math.nan, math.inf])
def test_a_comparison_needs_days(days):
    with pytest.raises(ValueError, match="days"):
        compare(total_groups([APPLE]), fruit_and_vegetables(), days)


def test_recommendations_follow_age_and_name_known_groups_and_ordered_amounts():
    assert recommendations(1.9) == ()
    assert [fruit_and_vegetables(age).low_g for age in (2, 5.9, 6, 9.9, 10, 80)] == [250, 250, 350, 350, 400, 400]
    assert {found.source[:3] for found in recommendations(17)} == {"WHO"}
    assert {found.source[:3] for found in recommendations(18)} == {"WHO", "EAT"}
    for found in recommendations(30):
        assert found.groups
        assert set(found.groups) <= set(FOOD_GROUPS)
        amounts = [grams for grams in (found.low_g, found.target_g, found.high_g) if grams is not None]
        assert amounts == sorted(amounts)
