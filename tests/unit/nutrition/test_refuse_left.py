import pytest

from app.nutrition.doubt import Doubt
from app.nutrition.foods import Density
from app.nutrition.mass import estimate_mass
from app.nutrition.refuse_left import REFUSE_ASSUMED, REFUSE_POSSIBLE, classify_left

BANANA = Density(0.94, 0.04, "raw", "solid", "measured", "a test")
DOUBT = Doubt(pair=0.03, item=0.05)


def mass(volume_ml, edible_share=0.64, doubt=DOUBT):
    return estimate_mass(volume_ml, doubt, BANANA, edible_share=edible_share)


def classes(served_ml, *left_ml, reviewed=None, edible_share=0.64):
    pieces = [mass(volume_ml, edible_share) if volume_ml is not None else None for volume_ml in left_ml]
    return classify_left(mass(served_ml, edible_share), pieces, reviewed or [None] * len(left_ml))


def test_banana_peel_is_classified_as_refuse_and_flagged():
    assert classes(150, 50) == [("refuse", REFUSE_ASSUMED)]


def test_half_a_banana_is_food_left_and_flagged_as_possible_refuse():
    assert classes(150, 80) == [("food_left", REFUSE_POSSIBLE)]


def test_piece_far_larger_than_any_refuse_is_food_left_without_a_flag():
    assert classes(150, 148) == [("food_left", None)]
    assert classes(150, 60, edible_share=0.96) == [("food_left", None)]


def test_food_that_is_eaten_whole_leaves_no_refuse():
    assert classes(150, 10, edible_share=1.0) == [("food_left", None)]


def test_peel_and_half_of_the_food_are_distinguished_by_amount():
    assert classes(150, 80, 40) == [("food_left", None), ("refuse", REFUSE_ASSUMED)]


def test_refuse_of_all_pieces_together_is_no_more_than_the_food_had():
    labels = [label for label, _ in classes(150, 40, 40, 40)]
    assert labels.count("refuse") == 1


def test_reviewed_refuse_counts_towards_the_limit():
    assert classes(150, 50, 40, reviewed=["refuse", None])[1][0] == "food_left"


@pytest.mark.parametrize("label", ["food_left", "refuse"])
def test_reviewed_class_is_kept_without_a_flag(label):
    assert classes(150, 50, reviewed=[label]) == [(label, None)]


def test_piece_of_unknown_amount_is_food_left():
    assert classes(150, None) == [("food_left", None)]


def test_item_of_unknown_amount_has_food_left():
    assert classify_left(None, [mass(50)], [None]) == [("food_left", None)]


def test_larger_doubt_classifies_larger_pieces_as_refuse():
    sure, unsure = Doubt(item=0.01), Doubt(item=0.3)
    served, piece = mass(150, doubt=sure), mass(60, doubt=sure)
    assert classify_left(served, [piece], [None])[0][0] == "food_left"
    assert classify_left(mass(150, doubt=unsure), [mass(60, doubt=unsure)], [None])[0][0] == "refuse"
