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


def test_board_turned_by_half_changes_no_match_of_foods_of_one_colour():
    pale = [sight(each.traits.centre_mm[0], each.traits.centre_mm[1], WHITE, 150.0) for each in PLATE]
    left = moved([sight(*each.traits.centre_mm, WHITE, 50.0) for each in LEFT], 180, 0, 0)
    assert matched(pale, left) == [1, 0, 2]


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


def random_meal(rng):
    """(served, left, whose each piece is) of a meal at random: boards laid anew, bitten foods, clutter now and then."""
    count = int(rng.integers(1, 5))
    colours = rng.uniform([25, -30, -10], [92, 55, 65], (count, 3))
    places = rng.uniform([-110, 60], [110, 280], (count, 2))
    volumes = rng.uniform(40, 250, count)
    served = [sight(*p, tuple(c), v) for p, c, v in zip(places, colours, volumes, strict=True)]
    angle = rng.uniform(0, 2 * np.pi) if rng.random() < 0.25 else 0.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = rng.uniform(-150, 150, 2) if angle else np.zeros(2)
    left, truth = [], []
    for i in np.flatnonzero(rng.random(count) < 0.6):
        at = turn @ (places[i] + rng.normal(0, 15, 2)) + shift
        is_bitten = rng.random() < 0.2
        lab = rng.uniform([60, -5, 5], [90, 10, 40]) if is_bitten else colours[i] + rng.normal(0, 6, 3)
        left.append(sight(*at, tuple(lab), volumes[i] * rng.uniform(0.1, 0.95) * np.exp(rng.normal(0, 0.08))))
        truth.append(int(i))
    if rng.random() < 0.1:
        lab, at = rng.uniform([20, -60, -60], [95, 60, 60]), rng.uniform([-200, 0], [200, 300])
        left.append(sight(*at, tuple(lab), rng.uniform(5, 60)))
        truth.append(None)
    order = rng.permutation(len(left))
    return served, [left[k] for k in order], [truth[k] for k in order]


def test_hardly_a_piece_of_five_hundred_random_meals_is_matched_wrongly():
    rng = np.random.default_rng(11)
    right = wrong = unsure = clutter = 0
    for _ in range(500):
        served, left, truth = random_meal(rng)
        for found, of in zip(matched(served, left), truth, strict=True):
            right += found == of and of is not None
            wrong += found is not None and found != of and of is not None
            unsure += found is None and of is not None
            clutter += found is not None and of is None
    pieces = right + wrong + unsure
    assert wrong < 0.03 * pieces
    assert right > 0.8 * pieces
    assert clutter < 25  # of some 50
