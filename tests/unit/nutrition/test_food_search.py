import pytest

from app.nutrition.foods import load_starter_table
from app.nutrition.search import find_food, rank_labels, search_foods


def keys(words):
    return [food.key for food in search_foods(load_starter_table(), words)]


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ("apple", "apple"),
        ("Apples", "apple"),
        ("orange", "orange"),
        ("orange juice", "orange-juice"),
        ("potatoes", "potato-baked"),
        ("mashed", "potato-mashed"),
        ("rice", "rice-white-cooked"),
        ("ban", "banana"),
        ("cheese", "cheese-cheddar"),
        ("chocolate cake", "cake-chocolate"),
        ("chocolate", "chocolate-chips"),
        ("egg", "egg-boiled"),
        ("chicken soup", "soup-chicken-noodle"),
    ],
)
def test_the_food_that_a_person_means_comes_first(words, first):
    assert keys(words)[0] == first


def test_apple_does_not_bring_up_foods_that_merely_contain_the_letters():
    assert keys("apple") == ["apple", "apple-green"]


def test_no_words_and_unknown_words_find_nothing():
    assert keys("") == keys("  ,") == keys("xyzzy") == []


def test_raw_apple_ranks_before_apple_strudel():
    assert rank_labels([("Strudel, apple",), ("Apple pie",), ("Apple, raw", "apple")], "apple") == [2, 1, 0]


@pytest.mark.parametrize(
    ("label", "key"),
    [
        ("apple", "apple"),
        ("green apple", "apple-green"),
        ("kiwi", "kiwifruit"),
        ("bread, slice", "bread-white"),
        ("cake, slice", "cake-chocolate"),
        ("egg, boiled", "egg-boiled"),
        ("potato, baked", "potato-baked"),
        ("mashed potato", "potato-mashed"),
        ("rice, cooked", "rice-white-cooked"),
        ("salad greens", "salad-greens"),
        ("Baked Potatoes", "potato-baked"),
    ],
)
def test_labels_that_phones_send_find_their_food(label, key):
    food = find_food(load_starter_table(), label)
    assert food is not None
    assert food.key == key


def test_a_label_that_is_no_foods_name_finds_none():
    assert find_food(load_starter_table(), "appl") is None
    assert find_food(load_starter_table(), "") is None


def test_each_food_is_found_by_its_own_name_and_no_two_share_a_label():
    table = load_starter_table()
    for food in table.foods:
        for label in (food.key, food.name, *food.aliases):
            assert find_food(table, label) is food, label
