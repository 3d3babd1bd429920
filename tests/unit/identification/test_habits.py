import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.identification.habits import (
    ANY_TIME,
    DAY_MINUTES,
    EQUAL_WEIGHT,
    NEW_FOODS,
    NEW_OF,
    SAME_TIME_SD_MINUTES,
    STUDY_WEIGHT,
    Eaten,
    log_prior,
    new_food_share,
    time_weights,
)

FOODS = ("apple", "bun", "egg", "plum")
NOON = 720
eaten = st.lists(st.builds(Eaten, st.sampled_from([*FOODS, "another"]), st.integers(0, DAY_MINUTES - 1)), max_size=30)


def shares(day_minute: int | None, own: list[Eaten], study: list[Eaten]) -> dict[str, float]:
    told = log_prior(counts(day_minute, own), counts(day_minute, study))
    return dict(zip(FOODS, np.exp(told).tolist(), strict=True))


def counts(day_minute: int | None, eaten: list[Eaten]) -> np.ndarray:
    """Of each food, weighed by the time of day."""
    weights = time_weights(day_minute)
    return np.array([sum(weights[one.day_minute] for one in eaten if one.food_key == food) for food in FOODS])


@given(st.none() | st.integers(0, DAY_MINUTES - 1), eaten, eaten)
def test_shares_add_up_to_1_rule_no_food_out_and_are_alike_without_history(day_minute, own, study):
    told = shares(day_minute, own, study)
    assert sum(told.values()) == pytest.approx(1.0)
    assert min(told.values()) > 0.0
    assert list(shares(day_minute, [], []).values()) == pytest.approx([0.25] * 4)


def test_shares_are_those_by_hand():
    own = [Eaten("apple", NOON)] * 3 + [Eaten("bun", NOON)]
    study = [Eaten("egg", NOON)] * 10
    told = shares(NOON, own, study)
    of_study = {"apple": 0.0, "bun": 0.0, "egg": 10.0, "plum": 0.0}
    of_own = {"apple": 3.0, "bun": 1.0, "egg": 0.0, "plum": 0.0}
    for food in FOODS:
        study_share = (of_study[food] + EQUAL_WEIGHT / 4) / (10.0 + EQUAL_WEIGHT)
        assert told[food] == pytest.approx((of_own[food] + STUDY_WEIGHT * study_share) / (4.0 + STUDY_WEIGHT))


def test_weight_of_a_meal_half_a_day_apart_is_by_hand_and_the_day_wraps_at_midnight():
    just_before, just_after = shares(5, [Eaten("egg", 1435)] * 9, []), shares(25, [Eaten("egg", 15)] * 9, [])
    assert just_before["egg"] == pytest.approx(just_after["egg"])
    assert shares(0, [Eaten("egg", 1439)] * 9, []) == pytest.approx(shares(0, [Eaten("egg", 1)] * 9, []))
    told = shares(NOON, [Eaten("egg", 0)] * 4, [])
    far = ANY_TIME + (1.0 - ANY_TIME) * math.exp(-0.5 * (720 / SAME_TIME_SD_MINUTES) ** 2)
    assert told["egg"] == pytest.approx((4 * far + STUDY_WEIGHT / 4) / (4 * far + STUDY_WEIGHT))


# ---- foods that the index does not know


@given(st.lists(st.integers(0, 50), max_size=8))
def test_known_foods_alone_make_new_ones_unlikely_and_new_ones_alone_make_them_likely(confirmed):
    counts = np.array(confirmed, np.float64)
    known, new = np.ones(len(counts), bool), np.zeros(len(counts), bool)
    assert new_food_share(np.zeros(0), np.zeros(0, bool)) == NEW_FOODS / NEW_OF
    assert new_food_share(np.array([200.0, 200.0]), np.array([True, True])) < 0.02
    assert new_food_share(np.ones(400), np.zeros(400, bool)) > 0.95
    assert new_food_share(np.array([400.0]), np.array([False])) < 0.02  # new once
    assert 0.0 < new_food_share(counts, known) <= new_food_share(counts, new) < 1.0
