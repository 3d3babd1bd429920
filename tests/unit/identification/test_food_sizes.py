import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.identification.sizes import (
    ANY_LOG_ML,
    ANY_LOG_SD,
    AS_EXPECTED,
    OWN_LOG_SD,
    FoodSize,
    food_sizes,
    log_volume,
    size_log_likelihoods,
)

APPLE = FoodSize(math.log(180.0), 0.3)


def food_size(volumes_ml: list[float]) -> FoodSize | None:
    """Of a food by its pieces, beside one of which no piece was measured."""
    logs = [log for log in map(log_volume, volumes_ml) if not math.isnan(log)]
    sums = [[float(len(logs)), 0.0], [sum(logs), 0.0], [sum(log**2 for log in logs), 0.0]]
    means, sds = food_sizes(*np.array(sums))
    assert np.isnan([means[1], sds[1]]).all()
    return None if math.isnan(means[0]) else FoodSize(float(means[0]), float(sds[0]))


def size_log_likelihood(size: FoodSize, volume_ml: float, relative_sd: float) -> float:
    means, sds = np.array([[size.log_mean, math.nan], [size.log_sd, math.nan]])
    told, unknown = size_log_likelihoods(means, sds, volume_ml, relative_sd)
    assert unknown == 0.0
    return float(told)


def normal_density(value: float, mean: float, sd: float) -> float:
    return math.exp(-0.5 * ((value - mean) / sd) ** 2) / (sd * math.sqrt(2.0 * math.pi))


@pytest.mark.parametrize(("volume_ml", "relative_sd"), [(180.0, 0.0), (90.0, 0.1), (600.0, 0.3)])
def test_ratio_is_that_of_the_mixture_by_hand(volume_ml, relative_sd):
    value = math.log(volume_ml)
    of_food = normal_density(value, APPLE.log_mean, math.sqrt(APPLE.log_sd**2 + relative_sd**2))
    of_any = normal_density(value, ANY_LOG_ML, math.sqrt(ANY_LOG_SD**2 + relative_sd**2))
    by_hand = math.log((AS_EXPECTED * of_food + (1.0 - AS_EXPECTED) * of_any) / of_any)
    assert size_log_likelihood(APPLE, volume_ml, relative_sd) == pytest.approx(by_hand)


@given(
    st.lists(st.floats(1e-300, 1e300), min_size=1, max_size=5),
    st.floats(min_value=0.0, exclude_min=True, allow_infinity=False),
    st.floats(0.0, 10.0),
)
def test_likelihood_of_any_volume_is_finite_and_bounded_below(volumes_ml, volume_ml, relative_sd):
    told = size_log_likelihood(food_size(volumes_ml), volume_ml, relative_sd)
    assert math.isfinite(told)
    assert told >= math.log(1.0 - AS_EXPECTED) - 1e-12


def test_one_piece_has_the_spread_of_foods_and_many_their_own_and_pieces_without_a_volume_are_left_out():
    size = food_size([120.0])
    assert size.log_mean == pytest.approx(math.log(120.0))
    assert size.log_sd == pytest.approx(OWN_LOG_SD * math.sqrt(2.0))
    volumes = np.exp(np.random.default_rng(0).normal(math.log(200.0), 0.15, 5000))
    size = food_size(volumes.tolist())
    assert size.log_mean == pytest.approx(math.log(200.0), abs=0.01)
    assert size.log_sd == pytest.approx(0.15, rel=0.03)
    once, twice = food_size([90.0, 110.0, 150.0]), food_size([180.0, 220.0, 300.0])
    assert twice.log_mean - once.log_mean == pytest.approx(math.log(2.0))
    assert twice.log_sd == pytest.approx(once.log_sd)
    assert food_size([100.0, 0.0, -5.0, math.nan, math.inf]) == food_size([100.0])
    assert food_size([]) is None
    assert food_size([0.0, math.nan]) is None
