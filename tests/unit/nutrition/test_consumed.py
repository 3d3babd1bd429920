"""What was eaten, against many simulated meals: two pairs with their own errors, one density that both share."""

import numpy as np
import pytest

from app.nutrition.doubt import Doubt
from app.nutrition.foods import Density
from app.nutrition.mass import consumed_mass, estimate_mass

DENSITY = Density(0.9, 0.054, "raw", "solid", "measured", "a test")  # 6 %
DOUBT = Doubt(pair=0.04, item=0.06)
EDIBLE = 0.8
MEALS = 2000


def factor(rng, relative_sd):
    return float(np.exp(rng.normal(0.0, np.sqrt(np.log1p(relative_sd**2)))))


def simulated(rng, served_ml, left_ml):
    """(estimate of what was eaten, truth), edible g, of one meal whose every error is drawn as its doubt says."""
    true_density = DENSITY.g_per_ml * factor(rng, DENSITY.relative_sd)
    before, after = factor(rng, DOUBT.pair), factor(rng, DOUBT.pair)

    def measured(volume_ml, pair):
        seen_ml = volume_ml * pair * factor(rng, DOUBT.item)
        return estimate_mass(seen_ml, DOUBT, DENSITY, edible_share=EDIBLE)

    found = consumed_mass(measured(served_ml, before), [measured(each, after) for each in left_ml], food_key="x")
    return found, true_density * EDIBLE * (served_ml - sum(left_ml))


@pytest.mark.parametrize("left_ml", [(20.0,), (60.0, 40.0), (200.0,)])
def test_ninety_percent_intervals_hold_nine_truths_in_ten(left_ml):
    rng = np.random.default_rng(17)
    meals = [simulated(rng, 200.0, left_ml) for _ in range(MEALS)]
    covered = np.mean([found.low <= truth <= found.high for found, truth in meals])
    assert covered == pytest.approx(0.9, abs=0.025)  # 2,000 draws: 0.7 % sd; the normal stands for lognormals: 1 %


@pytest.mark.parametrize("left_ml", [(100.0,), (200.0,)])
def test_signed_differences_are_right_on_average_and_clipped_ones_are_not(left_ml):
    rng = np.random.default_rng(18)
    meals = [simulated(rng, 200.0, left_ml) for _ in range(MEALS)]
    errors = np.array([found.value - truth for found, truth in meals])
    clipped = np.array([max(found.value, 0.0) - truth for found, truth in meals])
    standard_error = errors.std() / np.sqrt(MEALS)
    assert abs(errors.mean()) < 3.0 * standard_error + 0.005 * 144.0  # a lognormal's mean is above its median: 0.4 %
    if left_ml[0] > 180.0:
        assert clipped.mean() > 10.0 * standard_error  # what was hardly touched seems to have been eaten


def test_error_of_the_density_does_not_add_to_that_of_two_volumes_and_more_left_is_less_eaten():
    # Served and left are weighed by one density: 200 g - 180 g is as sure as the volumes are.
    sure = Density(0.9, 0.0, "raw", "solid", "measured", "a test")
    spread = [
        consumed_mass(estimate_mass(200.0, DOUBT, each), [estimate_mass(180.0, DOUBT, each)], food_key="x")
        for each in (sure, DENSITY)
    ]
    widths = [found.high - found.low for found in spread]
    assert widths[1] < 1.02 * widths[0]
    served = estimate_mass(200.0, DOUBT, DENSITY)
    eaten = [
        consumed_mass(served, [estimate_mass(left, DOUBT, DENSITY)], food_key="x").value for left in (20.0, 60.0, 190.0)
    ]
    assert eaten == sorted(eaten, reverse=True)
