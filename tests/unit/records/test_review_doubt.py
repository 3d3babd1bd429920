"""The order of the review queue: nothing that speaks against a record ever moves it down."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.nutrition.doubt import Estimate
from app.records.review.review_doubt import UNKNOWN, review_doubt

PROBABILITIES = st.floats(0.0, 1.0)
WIDTHS = st.floats(0.0, 1e6)
FLAGS = st.sets(st.sampled_from(["low_texture", "inside_guessed", "remeasuring", "leftover_unmatched"]))


def eaten(width_g, value_g=100.0):
    return Estimate(value_g, value_g - width_g / 2, value_g + width_g / 2)


def test_sure_item_is_in_no_doubt_and_an_unknown_one_in_all():
    assert review_doubt(1.0, eaten(0.0), 100.0, []) == 0.0
    assert review_doubt(1.0, None, 100.0, []) == UNKNOWN == 1.0


@given(PROBABILITIES, PROBABILITIES, WIDTHS, FLAGS)
def test_lower_probability_never_lowers_it(one, other, width_g, flags):
    lower, higher = sorted((one, other))
    assert review_doubt(lower, eaten(width_g), 100.0, flags) >= review_doubt(higher, eaten(width_g), 100.0, flags)


@given(PROBABILITIES, WIDTHS, WIDTHS, FLAGS)
def test_wider_interval_never_lowers_it(probability, one, other, flags):
    narrow, wide = sorted((one, other))
    before = review_doubt(probability, eaten(narrow), 100.0, flags)
    assert review_doubt(probability, eaten(wide), 100.0, flags) >= before


@given(PROBABILITIES, WIDTHS, FLAGS, FLAGS)
def test_further_flag_never_lowers_it(probability, width_g, flags, more):
    before = review_doubt(probability, eaten(width_g), 100.0, flags)
    assert review_doubt(probability, eaten(width_g), 100.0, flags | more) >= before


@given(PROBABILITIES, WIDTHS, FLAGS)
def test_what_is_merely_unsure_comes_behind_what_nobody_knows(probability, width_g, flags):
    assert 0.0 <= review_doubt(probability, eaten(width_g), 100.0, flags) < UNKNOWN


def test_it_is_the_same_for_a_large_and_a_small_helping_that_are_equally_unsure():
    small, large = review_doubt(0.8, eaten(3.0, 10.0), 10.0, []), review_doubt(0.8, eaten(300.0, 1000.0), 1000.0, [])
    assert small == pytest.approx(large)
