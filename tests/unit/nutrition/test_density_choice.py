import pytest

from app.nutrition.density import WRONG_KIND_RELATIVE_SD, resolve_density
from app.nutrition.foods import Density, load_starter_table
from tests.unit.nutrition.make_food import make_density, make_food


def test_bases_are_preferred_in_the_stated_order_and_the_studys_own_measurement_before_all_others():
    bases = ("group", "related", "portion", "fao", "measured")
    food = make_food(densities=[make_density(basis=basis) for basis in bases])
    choice = resolve_density(food, study_densities=[make_density(0.85, basis="measured")])
    assert (choice.chosen.g_per_ml, choice.chosen.basis) == (0.85, "study")
    order = [rejected.density.basis for rejected in choice.alternatives]
    assert order == ["measured", "fao", "portion", "related", "group"]
    assert resolve_density(food).chosen.basis == "measured"


def test_cup_of_slices_weighs_a_heap_of_slices_and_never_a_whole_apple():
    slices = make_density(0.46, kind="bulk", basis="portion", state="slices")
    group = make_density(0.97, 0.24, basis="group", state="any")
    choice = resolve_density(make_food(densities=[slices, group]))
    assert choice.chosen is group
    assert "bulk, but a whole piece takes a solid density" in choice.alternatives[0].reason
    apple = load_starter_table().food("apple")
    assert resolve_density(apple).chosen.kind == "solid"
    heap = resolve_density(apple, form="heap")
    assert heap.chosen.kind == "bulk"
    assert 0.45 < heap.chosen.g_per_ml < 0.55


def test_without_the_right_kind_the_best_other_is_taken_with_a_wide_spread():
    choice = resolve_density(make_food(densities=[make_density(0.3, 0.02)]), form="heap")
    assert choice.chosen.g_per_ml == 0.3
    assert choice.chosen.relative_sd == pytest.approx(WRONG_KIND_RELATIVE_SD)
    assert "no bulk density" in choice.reason


def test_chosen_and_alternatives_are_all_that_is_known_and_none_where_nothing_is():
    for food in load_starter_table().foods:
        choice = resolve_density(food)
        shown = [choice.chosen, *(rejected.density for rejected in choice.alternatives)]
        assert sorted(map(repr, shown)) == sorted(map(repr, food.densities))
    assert resolve_density(make_food()) is None


@pytest.mark.parametrize(("g_per_ml", "sd"), [(0.0, 0.1), (-1.0, 0.1), (float("nan"), 0.1), (1.0, -0.1)])
def test_impossible_density_cannot_be_made(g_per_ml, sd):
    with pytest.raises(ValueError, match="invalid density"):
        Density(g_per_ml, sd, "raw", "solid", "fao", "nowhere")
