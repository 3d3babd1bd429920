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


FOOD = ("food_left", None)


@pytest.mark.parametrize(
    ("left_ml", "edible_share", "expected"),
    [
        ([50], 0.64, [("refuse", REFUSE_ASSUMED)]),  # a banana's peel
        ([80], 0.64, [("food_left", REFUSE_POSSIBLE)]),  # half a banana
        ([148], 0.64, [FOOD]),  # far larger than any refuse
        ([60], 0.96, [FOOD]),
        ([10], 1.0, [FOOD]),  # eaten whole
        ([80, 40], 0.64, [FOOD, ("refuse", REFUSE_ASSUMED)]),
        ([None], 0.64, [FOOD]),  # of unknown amount
    ],
)
def test_piece_is_refuse_if_it_weighs_no_more_than_the_foods_refuse(left_ml, edible_share, expected):
    assert classes(150, *left_ml, edible_share=edible_share) == expected


def test_reviewed_class_is_kept_and_refuse_of_all_pieces_together_is_no_more_than_the_food_had():
    assert [label for label, _ in classes(150, 40, 40, 40)].count("refuse") == 1
    assert classes(150, 50, 40, reviewed=["refuse", None])[1][0] == "food_left"
    for label in ("food_left", "refuse"):
        assert classes(150, 50, reviewed=[label]) == [(label, None)]
    assert classify_left(None, [mass(50)], [None]) == [FOOD]  # the item's own amount is unknown


def test_larger_doubt_classifies_larger_pieces_as_refuse():
    sure, unsure = Doubt(item=0.01), Doubt(item=0.3)
    served, piece = mass(150, doubt=sure), mass(60, doubt=sure)
    assert classify_left(served, [piece], [None])[0][0] == "food_left"
    assert classify_left(mass(150, doubt=unsure), [mass(60, doubt=unsure)], [None])[0][0] == "refuse"
