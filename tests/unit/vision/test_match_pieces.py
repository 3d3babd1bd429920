import math

import numpy as np
import pytest

from app.vision.leftovers import MIN_MARGIN, Sight, match_pieces
from app.vision.model import ItemTraits

RED, YELLOW, GREEN, WHITE = (45.0, 50.0, 30.0), (80.0, 5.0, 65.0), (50.0, -30.0, 35.0), (88.0, 0.0, 12.0)


def sight(x=0.0, y=100.0, lab=RED, volume_ml=150.0, food=None, radius_mm=30.0):
    return Sight(ItemTraits((x, y), radius_mm, lab), volume_ml, 0.08, food)


def unseen(volume_ml=150.0, food=None):
    return Sight(ItemTraits(), volume_ml, 0.08, food)


def matched(served, left, told=None):
    return [match.served for match in match_pieces(served, left, told)]


PLATE = [sight(-60, 100, RED), sight(40, 110, YELLOW), sight(0, 180, GREEN)]
LEFT = [sight(45, 105, YELLOW, 60.0), sight(-55, 95, RED, 40.0), sight(5, 175, GREEN, 30.0)]


def moved(sights, degrees, x, y):
    angle = math.radians(degrees)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    out = []
    for each in sights:
        px, py = turn @ each.traits.centre_mm + [x, y]
        out.append(sight(px, py, each.traits.lab, each.volume_ml, each.food))
    return out


def test_pieces_are_of_the_items_that_stood_there_with_their_colour():
    assert matched(PLATE, LEFT) == [1, 0, 2]
    assert matched(PLATE[::-1], LEFT[::-1]) == [0, 2, 1]
    assert all(match.margin > MIN_MARGIN for match in match_pieces(PLATE, LEFT))
    for degrees in (25, 140, 250):  # a board laid anew changes nothing where colours tell
        assert matched(PLATE, moved(LEFT, degrees, 120, -80)) == [1, 0, 2]
    assert matched(PLATE, [sight(-58, 104, WHITE, 60.0)]) == [0]  # a bitten apple that shows its flesh, by its place


NAPKIN = sight(250, -120, (60.0, 5.0, -45.0), 20.0)
BY_COLOUR = Sight(ItemTraits(None, None, RED), 150.0, 0.1), Sight(ItemTraits(None, None, (50.0, 45.0, 28.0)), 60.0, 0.1)


MATCHES = {
    "napkin of a colour and at a place of no food": (PLATE, [NAPKIN], [None]),
    "larger than anything served": ([sight(volume_ml=100.0)], [sight(volume_ml=400.0)], [None]),
    "a little larger than its item": ([sight(volume_ml=100.0)], [sight(volume_ml=108.0)], [0]),
    "two of one item": (PLATE, [sight(-75, 95, RED, 40.0), sight(-45, 105, RED, 30.0)], [0, 0]),
    "more than was served": (PLATE, [sight(-61, 100, RED, 140.0), sight(-40, 105, RED, 140.0)], [0, None]),
    "same food, nothing seen": ([unseen(food="apple"), unseen(food="banana")], [unseen(50.0, "banana")], [1]),
    "nothing known of two items": ([unseen(), unseen()], [unseen(50.0)], [None]),
    "only item by its colour alone": (BY_COLOUR[:1], BY_COLOUR[1:], [0]),
    "nothing served": ([], LEFT, [None, None, None]),
}


@pytest.mark.parametrize(("served", "left", "expected"), MATCHES.values(), ids=MATCHES)
def test_pieces_are_matched_by_what_is_known_of_them_or_not_at_all(served, left, expected):
    assert matched(served, left) == expected


def test_four_foods_of_one_colour_are_told_by_their_arrangement_though_the_board_was_laid_anew():
    served = [sight(x, y, WHITE) for x, y in [(-90, 60), (80, 90), (10, 200), (-40, 130)]]
    left = moved([sight(x, y, WHITE, 60.0) for x, y in [(10, 200), (-90, 60), (80, 90), (-40, 130)]], 70, 300, 40)
    assert matched(served, left) == [2, 0, 1, 3]


def test_two_foods_of_one_colour_that_both_moved_are_not_told_apart():
    served = [sight(-60, 100, WHITE, food="rice"), sight(60, 100, WHITE, food="mozzarella")]
    left = moved([sight(-60, 100, WHITE, 60.0)], 80, 500, 300)
    assert match_pieces(served, left)[0].served is None
    assert match_pieces(served, left)[0].is_ambiguous


def test_alike_pieces_of_the_same_food_are_matched_since_no_total_changes():
    served = [sight(-60, 100, RED, food="apple"), sight(60, 100, RED, food="apple")]
    left = moved([sight(-60, 100, RED, 60.0), sight(60, 100, RED, 30.0)], 80, 500, 300)
    assert sorted(matched(served, left)) == [0, 1]


def test_what_a_person_names_holds_against_place_and_colour():
    assert matched(PLATE, LEFT, {0: 2})[0] == 2
    assert matched(PLATE, LEFT, {1: None})[1] is None
    assert matched(PLATE, LEFT, {0: 1}) == [1, 0, 2]  # and leaves the others their items
