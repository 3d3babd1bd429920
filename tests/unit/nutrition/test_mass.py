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


@pytest.mark.parametrize(
    ("volume_ml", "share", "word"),
    [(0.0, 1.0, "volume"), (float("nan"), 1.0, "volume"), (float("inf"), 1.0, "volume")]
    + [(100.0, share, "edible share") for share in (0.0, 1.1, float("nan"))],
)
def test_impossible_volume_or_edible_share_is_refused(volume_ml, share, word):
    with pytest.raises(ValueError, match=word):
        estimate_mass(volume_ml, Doubt(), make_density(), edible_share=share)


def test_refuse_is_off_the_edible_share_but_for_parts_that_were_taken_off_or_not_served():
    table = load_starter_table()
    assert edible_share(table.food("banana")) == pytest.approx(0.64)
    assert edible_share(table.food("banana"), form="heap") == 1.0  # peeled and sliced
    pineapple = table.food("pineapple")
    assert edible_share(pineapple) == pytest.approx(0.51)
    crown = next(part.percent for part in pineapple.refuse if part.part == "crown")
    assert edible_share(pineapple, without={"crown"}) == pytest.approx(51.0 / (100.0 - crown))
    assert edible_share(pineapple, without={part.part for part in pineapple.refuse}) == pytest.approx(1.0)
    egg = make_food(refuse=[("shell", 12.0, False)])
    assert edible_share(egg) == pytest.approx(1.0)
    assert edible_share(egg, without=()) == pytest.approx(0.88)
    with pytest.raises(ValueError, match="no part crown"):
        edible_share(make_food(refuse=[("core", 10.0)]), without={"crown"})
