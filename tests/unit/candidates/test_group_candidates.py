from app.candidates.food_groups import candidate_answers, groups_of_foods
from app.identification.food_index import shipped_index
from app.identification.identifier import Candidate, Identification
from app.nutrition.foods import load_starter_table


def identified(foods, groups):
    def candidates(probabilities):
        return tuple(Candidate(None, None, key, p, 9) for key, p in probabilities.items())

    return Identification(candidates(foods), candidates(groups), 0.0, "test")


def shown(foods, groups):
    return [(each.food, each.is_group) for each in candidate_answers(identified(foods, groups))]


def test_group_comes_first_where_it_is_likely_and_says_more_than_its_foods():
    assert shown({"orange": 0.5, "lemon": 0.4}, {"citrus-fruit": 0.93, "stone-fruit": 0.1}) == [
        ("citrus-fruit", True),
        ("orange", False),
        ("lemon", False),
    ]


def test_no_group_is_offered_beside_a_sure_food_nor_an_unlikely_one_nor_one_less_likely_than_a_food():
    assert shown({"orange": 0.85}, {"citrus-fruit": 0.99}) == [("orange", False)]
    assert shown({"orange": 0.3}, {"citrus-fruit": 0.49}) == [("orange", False)]
    assert shown({"plum": 0.7}, {"citrus-fruit": 0.79}) == [("plum", False)]
    assert shown({}, {}) == []


def test_groups_are_of_foods_of_the_table_and_two_of_each_are_known_to_the_index():
    table = {food.key for food in load_starter_table().foods}
    known = {food.food_key for food in shipped_index().foods}
    for key, members in groups_of_foods().items():
        assert key in table
        assert members < table
        assert not members & groups_of_foods().keys()
        assert len(members & known) > 1, key
