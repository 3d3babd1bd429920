import pytest

from app.nutrition.doubt import Doubt, estimate
from app.nutrition.foods import load_starter_table
from app.nutrition.mass import edible_share, estimate_mass
from tests.unit.nutrition.make_food import make_density, make_food


def test_mass_is_volume_times_density_and_its_doubt_joins_both():
    mass = estimate_mass(200.0, Doubt(pair=0.05, item=0.08), make_density(0.8, 0.04))
    assert mass.as_seen_g.value == pytest.approx(160.0)
    assert (mass.doubt.pair, mass.doubt.density, mass.doubt.item) == pytest.approx((0.05, 0.05, 0.08))
    assert mass.as_seen_g == estimate(160.0, mass.doubt)
    assert mass.edible_g == mass.as_seen_g


def test_refuse_scales_the_mass_and_its_interval():
    mass = estimate_mass(150.0, Doubt(item=0.1), make_density(0.924, 0.063), edible_share=0.64)
    assert mass.edible_g.value == pytest.approx(150.0 * 0.924 * 0.64)
    assert mass.edible_g.low == pytest.approx(mass.as_seen_g.low * 0.64)


def test_twice_the_volume_weighs_twice():
    once = estimate_mass(150.0, Doubt(item=0.1), make_density())
    twice = estimate_mass(300.0, Doubt(item=0.1), make_density())
    assert twice.as_seen_g.high == pytest.approx(2.0 * once.as_seen_g.high)


@pytest.mark.parametrize("volume_ml", [0.0, -5.0, float("nan"), float("inf")])
def test_impossible_volume_is_refused(volume_ml):
    with pytest.raises(ValueError, match="volume"):
        estimate_mass(volume_ml, Doubt(), make_density())


@pytest.mark.parametrize("share", [0.0, -0.1, 1.1, float("nan")])
def test_impossible_edible_share_is_refused(share):
    with pytest.raises(ValueError, match="edible share"):
        estimate_mass(100.0, Doubt(), make_density(), edible_share=share)


def test_banana_in_its_skin_is_64_percent_edible():
    assert edible_share(load_starter_table().food("banana")) == pytest.approx(0.64)


def test_peeled_and_sliced_fruit_in_a_heap_has_no_refuse():
    assert edible_share(load_starter_table().food("banana"), form="heap") == 1.0


def test_pineapple_without_its_crown_has_less_refuse():
    pineapple = load_starter_table().food("pineapple")
    assert edible_share(pineapple) == pytest.approx(0.51)
    crown = next(part.percent for part in pineapple.refuse if part.part == "crown")
    assert edible_share(pineapple, without={"crown"}) == pytest.approx(51.0 / (100.0 - crown))
    assert edible_share(pineapple, without={part.part for part in pineapple.refuse}) == pytest.approx(1.0)


def test_refuse_that_is_not_served_is_off_by_default():
    egg = make_food(refuse=[("shell", 12.0, False)])
    assert edible_share(egg) == pytest.approx(1.0)
    assert edible_share(egg, without=()) == pytest.approx(0.88)


def test_unknown_part_is_refused():
    with pytest.raises(ValueError, match="no part crown"):
        edible_share(make_food(refuse=[("core", 10.0)]), without={"crown"})
