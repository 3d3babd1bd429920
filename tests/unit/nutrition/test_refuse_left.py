import pytest

from app.nutrition.doubt import Doubt
from app.nutrition.foods import Density
from app.nutrition.mass import estimate_mass
from app.nutrition.refuse_left import REFUSE_ASSUMED, REFUSE_POSSIBLE, classify_left

BANANA = Density(0.94, 0.04, "raw", "solid", "measured", "a test")
DOUBT = Doubt(pair=0.03, item=0.05)


def mass(volume_ml, edible_share=0.64, doubt=DOUBT):
    return estimate_mass(volume_ml, doubt, BANANA, edible_share=edible_share)


def classes(served_ml, *left_ml, told=None, edible_share=0.64):
    pieces = [mass(each, edible_share) if each is not None else None for each in left_ml]
    return classify_left(mass(served_ml, edible_share), pieces, told or [None] * len(left_ml))


def test_peel_of_a_banana_is_taken_for_refuse_and_flagged():
    assert classes(150, 50) == [("refuse", REFUSE_ASSUMED)]


def test_half_a_banana_is_food_left_that_may_hold_a_hollow_peel():
    assert classes(150, 80) == [("food_left", REFUSE_POSSIBLE)]


def test_piece_far_larger_than_any_refuse_is_food_left_without_a_flag():
    assert classes(150, 148) == [("food_left", None)]
    assert classes(150, 60, edible_share=0.96) == [("food_left", None)]


def test_food_that_is_eaten_whole_leaves_no_refuse():
    assert classes(150, 10, edible_share=1.0) == [("food_left", None)]


def test_peel_and_half_of_the_food_are_told_apart_by_their_amounts():
    assert classes(150, 80, 40) == [("food_left", None), ("refuse", REFUSE_ASSUMED)]


def test_refuse_of_all_pieces_together_is_no_more_than_the_food_had():
    found = [name for name, _ in classes(150, 40, 40, 40)]
    assert found.count("refuse") == 1


def test_refuse_that_was_told_leaves_no_room_for_more():
    assert classes(150, 50, 40, told=["refuse", None])[1][0] == "food_left"


@pytest.mark.parametrize("word", ["food_left", "refuse"])
def test_what_a_person_says_holds_without_a_flag(word):
    assert classes(150, 50, told=[word]) == [(word, None)]


def test_piece_of_unknown_amount_is_food_left():
    assert classes(150, None) == [("food_left", None)]


def test_item_of_unknown_amount_has_food_left():
    assert classify_left(None, [mass(50)], [None]) == [("food_left", None)]


def test_more_doubt_lets_more_pass_for_refuse():
    sure, unsure = Doubt(item=0.01), Doubt(item=0.3)
    served, piece = mass(150, doubt=sure), mass(60, doubt=sure)
    assert classify_left(served, [piece], [None])[0][0] == "food_left"
    assert classify_left(mass(150, doubt=unsure), [mass(60, doubt=unsure)], [None])[0][0] == "refuse"
