"""A pizza of a published table weighs what the starter's pizzas weigh, and not what its group's chilli does."""

import pytest

from app.nutrition.density import resolve_density
from app.nutrition.foods import load_starter_table
from app.nutrition.group_density import kind_density

STARTER = {food.key: food for food in load_starter_table().foods}


@pytest.mark.parametrize(
    ("name", "group", "like"),
    [
        ('PIZZA HUT 14" Cheese Pizza, Pan Crust', "Fast Foods", "pizza-cheese"),
        ("Fast foods, cheeseburger; double, regular patty, plain", "Fast Foods", "cheeseburger"),
        ("Pie, blueberry, commercially prepared", "Baked Products", "pie-apple"),
        ("Bread, white, commercially prepared (includes soft bread crumbs)", "Baked Products", "bread-white"),
        ("TACO BELL, Bean Burrito", "Fast Foods", "burrito-bean-cheese"),
    ],
)
def test_kind_that_the_name_tells_weighs_as_the_starters_foods_of_it(name, group, like):
    (density,) = kind_density(name, group, "slab")
    assert density.g_per_ml == pytest.approx(resolve_density(STARTER[like]).chosen.g_per_ml, rel=0.15)
    assert density.basis == "group"
    assert density.relative_sd > 0.24


@pytest.mark.parametrize(
    ("name", "group", "form"),
    [
        ("Turkey roll, light meat", "Poultry Products", "slab"),
        ("Bread crumbs, dry, grated, plain", "Baked Products", "slab"),
        ("Cake, yellow, dry mix", "Baked Products", "slab"),
        ("Egg rolls, chicken, refrigerated, heated", "Meals, Entrees, and Side Dishes", "slab"),
        ("TACO BELL, Taco Salad", "Fast Foods", "heap"),
    ],
)
def test_what_is_no_piece_of_a_kind_has_no_density_of_it(name, group, form):
    assert kind_density(name, group, form) == ()
