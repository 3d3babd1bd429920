"""The factor that a meal's lengths should have, by the usual sizes of dishes and foods."""

import pytest

from app.identification.sizes import FoodSize, MeasuredFood, plausible_factor

APPLE, EGG = FoodSize(5.3, 0.25), FoodSize(4.0, 0.2)  # 200 and 55 ml


def table(factor, *, plates=(), bowls=(), cups=(), camera=350.0, foods=()):
    """A table whose marker was declared `factor` times too large. foods: (ml, the foods that it may be)."""
    radii = {
        kind: [factor * each for each in radii]
        for kind, radii in zip(("plate", "bowl", "cup"), (plates, bowls, cups), strict=True)
        if radii
    }
    radii["camera"] = [factor * camera]
    return radii, [MeasuredFood(factor**3 * volume, 0.05, kinds) for volume, kinds in foods]


TABLES = [
    {"plates": [118.0], "foods": [(185.0, [(1.0, APPLE)])]},
    {"plates": [135.0], "cups": [38.0], "foods": [(230.0, [(0.7, APPLE), (0.2, EGG)]), (90.0, [])]},
    {"foods": [(60.0, [(1.0, EGG)]), (170.0, [(1.0, APPLE)])]},
]


@pytest.mark.parametrize("table_of", TABLES)
@pytest.mark.parametrize("declared", [2.0, 0.5])
def test_wrong_size_is_told_with_its_factor(table_of, declared):
    assert plausible_factor(*table(declared, **table_of)) == pytest.approx(1.0 / declared, rel=0.25)


@pytest.mark.parametrize("table_of", [*TABLES, {}, {"plates": [78.0]}, {"plates": [165.0], "bowls": [70.0]}])
@pytest.mark.parametrize("declared", [1.0, 0.97, 1.03])
def test_usual_table_by_any_printer_is_not_doubted(table_of, declared):
    assert plausible_factor(*table(declared, **table_of)) is None


@pytest.mark.parametrize(
    "foods", [[(12.0, [(1.0, APPLE)])], [(620.0, [(1.0, APPLE)])], [(900.0, [(0.4, APPLE)])], [(1800.0, [])]]
)
def test_slice_several_pieces_and_an_unknown_food_do_not_doubt_a_usual_plate(foods):
    assert plausible_factor(*table(1.0, plates=[120.0], foods=foods)) is None


@pytest.mark.parametrize(
    "unusual",
    [
        {"plates": [120.0, 35.0, 33.0, 36.0]},
        {"bowls": [35.0, 36.0]},
        {"foods": [(15.0, [])] * 6},
        {"foods": [(5.0, [])] * 3},
    ],
    ids=["sauce dishes", "dip bowls", "small pieces", "garnish"],
)
def test_small_dishes_and_pieces_of_one_meal_count_once(unusual):
    assert plausible_factor(*table(1.0, **unusual, camera=400.0)) is None
