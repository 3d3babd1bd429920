import math

import numpy as np
import pytest

from app.identification.examples import NumberedIndex
from app.identification.groups import TEMPERATURE, group_probabilities
from app.identification.identifier import Circumstances, Identifier
from app.identification.kernel_classifier import Calibration
from tests.unit.identification.small_index import LOOKS, pictures_of, small_index

BETWEEN = {"either": ("apple-raw", "bun-raw"), "others": ("egg-raw", "plum-raw"), "alone": ("egg-raw", "none")}


def group_of(found, key):
    return next(each for each in found.groups if each.food_key == key)


def test_group_is_a_class_of_its_own_with_the_scores_and_priors_of_its_members_together():
    calibration, none_prior = Calibration(0.1, 0.3), 0.2
    scores, log_odds = np.array([0.4, 0.35, 0.1]), np.log([0.5, 0.25, 0.25])
    own = np.array([True, True, False])
    found = group_probabilities(scores, log_odds, {"a": own}, calibration, none_prior)
    by_hand = [
        0.75 * 0.8 * math.exp(0.75 / (0.1 * TEMPERATURE)),
        0.25 * 0.8 * math.exp(0.1 / (0.1 * TEMPERATURE)),
        0.2 * math.exp(0.3 / (0.1 * TEMPERATURE)),
    ]
    assert found == {"a": pytest.approx(by_hand[0] / sum(by_hand))}


def test_region_between_two_foods_is_surely_of_their_group_and_of_no_other():
    apple, bun = pictures_of("apple", 1, seed=7)[0], pictures_of("bun", 1, seed=7)[0]
    found = Identifier(NumberedIndex(small_index()), groups=BETWEEN).identify((apple + bun) / 2)
    best = found.candidates[0].probability
    assert best < 0.8
    assert group_of(found, "either").probability > max(0.8, best)
    assert group_of(found, "others").probability < 0.1
    assert group_of(found, "either").specimens == 20
    assert [each.probability for each in found.groups] == sorted(
        (each.probability for each in found.groups), reverse=True
    )


def test_group_with_one_food_of_the_index_is_none_and_unknown_looks_belong_to_none():
    identifier = Identifier(NumberedIndex(small_index()), groups=BETWEEN)
    assert {each.food_key for each in identifier.identify(pictures_of("egg", 1)[0]).groups} == {"either", "others"}
    for look in LOOKS[4:]:
        found = identifier.identify(pictures_of(look, 1, seed=7)[0])
        assert max(each.probability for each in found.groups) < 0.5


def test_size_speaks_for_a_group_as_for_its_members():
    index = small_index(volumes_ml={"apple": (100.0, 110.0), "bun": (100.0, 110.0)})
    identifier = Identifier(NumberedIndex(index), groups=BETWEEN)
    between = (pictures_of("apple", 1, seed=7)[0] + pictures_of("bun", 1, seed=7)[0]) / 2
    fits, is_too_large = (
        group_of(identifier.identify(between, Circumstances(volume_ml=volume_ml)), "either").probability
        for volume_ml in (105.0, 900.0)
    )
    assert fits > is_too_large
