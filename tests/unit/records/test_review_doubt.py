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


def test_doubt_is_none_of_a_sure_item_1_of_an_unknown_one_and_the_same_for_large_and_small_helpings():
    assert review_doubt(1.0, eaten(0.0), 100.0, []) == 0.0
    assert review_doubt(1.0, None, 100.0, []) == UNKNOWN == 1.0
    small, large = review_doubt(0.8, eaten(3.0, 10.0), 10.0, []), review_doubt(0.8, eaten(300.0, 1000.0), 1000.0, [])
    assert small == pytest.approx(large)


@given(st.tuples(PROBABILITIES, PROBABILITIES), st.tuples(WIDTHS, WIDTHS), FLAGS, FLAGS)
def test_lower_probability_wider_interval_and_further_flag_never_lower_it(probabilities, widths, flags, more):
    (lower, higher), (narrow, wide) = sorted(probabilities), sorted(widths)
    doubt = review_doubt(higher, eaten(narrow), 100.0, flags)
    assert 0.0 <= doubt < UNKNOWN
    assert review_doubt(lower, eaten(narrow), 100.0, flags) >= doubt
    assert review_doubt(higher, eaten(wide), 100.0, flags) >= doubt
    assert review_doubt(higher, eaten(narrow), 100.0, flags | more) >= doubt
