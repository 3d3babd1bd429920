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
