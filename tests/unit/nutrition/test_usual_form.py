"""How a food usually lies, and how it was prepared, by the words of published names."""

import pytest

from app.nutrition.usual_form import cup_kind, is_mixed_dish, is_served, usual_form, usual_state


@pytest.mark.parametrize(
    ("name", "group", "form"),
    [
        ("Apples, raw, with skin", "Fruits and Fruit Juices", "whole"),
        ("Pineapple, canned, juice pack, solids and liquids", "Fruits and Fruit Juices", "heap"),
        ("Tomatoes, red, ripe, canned, packed in tomato juice", "Vegetables and Vegetable Products", "heap"),
        ("Potatoes, mashed, prepared from granules with milk, water", "Vegetables and Vegetable Products", "heap"),
        ("Corn, sweet, yellow, frozen, kernels on cob, unprepared", "Vegetables and Vegetable Products", "whole"),
        ("Fish, tuna, light, canned in water, drained solids", "Finfish and Shellfish Products", "heap"),
        ("Beef, ground, 93% lean, patty, cooked", "Beef Products", "slab"),
        ("Cereals ready-to-eat, GENERAL MILLS, COCOA PUFFS", "Breakfast Cereals", "heap"),
        ("Ice cream sandwich", "Dairy and Egg Products", "slab"),
        ("Cream, whipped, cream topping, pressurized", "Dairy and Egg Products", "heap"),
        ("Beverages, tea, green, instant, unsweetened", "Beverages", "heap"),
        ("Soup, cream of potato, canned", "Soups, Sauces, and Gravies", "liquid"),
        ("Leavening agents, baking powder, low-sodium", "Baked Products", "heap"),
        ("Fast foods, hamburger; single, large patty", "Fast Foods", "slab"),
        ("Veggie burgers or soyburgers, unprepared", "Legumes and Legume Products", "slab"),
        ("Butter oil, anhydrous", "Dairy and Egg Products", "liquid"),
        ("Milk, buttermilk, fluid, whole", "Dairy and Egg Products", "liquid"),
    ],
)
def test_form_follows_the_group_and_the_words(name, group, form):
    assert usual_form(name, group) == form


@pytest.mark.parametrize(
    ("name", "state"),
    [
        ("Rice, white, long-grain, parboiled, dry", "raw"),
        ("Rice, white, long-grain, cooked", "cooked"),
        ("Cookies, chocolate chip, refrigerated dough", "raw"),
    ],
)
def test_dry_goods_and_dough_are_raw_and_never_cooked(name, state):
    assert usual_state(name) == state


def test_dishes_are_known_by_their_group_or_words_and_a_cup_tells_of_the_slab_of_butter_alone():
    assert is_mixed_dish("Lasagna with meat sauce", "Meals, Entrees, and Side Dishes")
    assert is_mixed_dish("Fast foods, burrito, with beans", "Fast Foods")
    assert not is_mixed_dish("Fast foods, potato, french fried", "Fast Foods")
    assert cup_kind("Butter, salted", "Fats and Oils", "slab") == "solid"
    assert cup_kind("Peanut butter, smooth style", "Legumes and Legume Products", "slab") == "solid"
    assert cup_kind("Sugars, granulated", "Sweets", "slab") is None
    assert cup_kind("Cereals ready-to-eat, PEANUT BUTTER TOAST CRUNCH", "Breakfast Cereals", "heap") is None


@pytest.mark.parametrize(
    ("part", "name", "form", "is_there"),
    [
        ("skin", "Bananas, raw", "whole", True),
        ("bone", "Chicken, breast, meat only, roasted", "slab", False),
        ("shell", "Egg, whole, cooked, hard-boiled", "whole", False),
        ("pits and stems", "Cherries, sweet, raw", "heap", True),
        ("shells", "Nuts, almonds", "heap", False),
        ("outer leaves, core and trimmings", "Lettuce, iceberg, raw", "heap", False),
        ("pods and inedible peas", "Soup, of peas", "in_vessel", False),
    ],
)
def test_heap_was_trimmed_and_meat_only_boned_before_the_plate(part, name, form, is_there):
    assert is_served(part, name, form) == is_there
