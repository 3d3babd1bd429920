from dataclasses import replace

import pytest

from app.nutrition.search import Candidate, Query, QueryWord, label_key, posting_ranks, rank, split_words


def query(text, joined=0, **typos):
    return Query(tuple(QueryWord(word, typos.get(word, {})) for word in split_words(text)), joined)


def food(*labels, group="Fruits and Fruit Juices", **changes):
    plain = Candidate(labels, group, None, is_mixed_dish=False, is_curated=False, is_fndds=False, order=(0,))
    return replace(plain, **changes)


def ranked(text, *foods, **typos):
    return [foods[match.position].labels[0] for match in rank([query(text, **typos)], foods)]


@pytest.mark.parametrize(
    ("words", "better", "worse"),
    [
        ("apple", "Apples, raw, with skin", "Strudel, apple"),
        ("apple", "Apples, raw, with skin", "Apple juice, canned"),
        ("apple", "Apples, raw, with skin", "Apples, raw, golden delicious, with skin"),
        ("apple juice", "Apple juice, canned", "Apples, canned, packed in juice"),
        ("coffee", "Beverages, coffee, brewed", "Liqueur, coffee"),
        ("corn flakes", "Cereals ready-to-eat, corn flakes", "KELLOGG'S Corn Flakes"),
        ("milk", "Milk, whole", "Milk chocolate"),
        ("chicken", "Chicken, broilers or fryers, breast, meat and skin, roasted", "Chicken, skin, roasted"),
        ("hamburger", "Fast foods, hamburger; single patty; plain", "Pickle relish, hamburger"),
    ],
)
def test_what_a_person_means_goes_first_whatever_the_tables_order(words, better, worse):
    assert ranked(words, food(worse), food(better)) == [better, worse]


def test_grain_is_eaten_cooked_food_for_babies_goes_behind_and_equal_foods_keep_the_tables_order():
    rice = [food(f"Rice, {state}", group="Cereal Grains and Pasta", state=state) for state in ("raw", "cooked")]
    assert ranked("rice", *rice) == ["Rice, cooked", "Rice, raw"]
    foods = food("Bananas, with tapioca, strained", group="Baby Foods"), food("Bananas, sliced, with apple and mango")
    assert ranked("banana", *foods)[0] == "Bananas, sliced, with apple and mango"
    foods = food("Cheese, brie", order=(1,)), food("Cheese, edam", order=(0,))
    assert ranked("cheese", *foods) == ["Cheese, edam", "Cheese, brie"]
    foods = food("Beef, ground, raw", "hamburger"), food("Fast foods, hamburger; single, regular patty; plain")
    assert ranked("hamburger", *foods)[0] == foods[1].labels[0]  # a published table gives an alias to many foods


def test_all_words_match_in_one_label_figures_whole_and_in_a_script_without_blanks_parts():
    assert ranked("apple pie", food("Apples, raw"), food("Pie, cherry")) == []
    assert ranked("red banana", food("Bananas, raw", "red fruit")) == []
    assert ranked("2% milk", food("Milk, 20 g protein"), food("Milk, reduced fat, 2%")) == ["Milk, reduced fat, 2%"]
    assert ranked("果", food("苹果")) == ["苹果"]


def test_a_word_as_typed_goes_before_a_mistyped_one_and_one_wrong_letter_before_two():
    foods = food("Pears, raw"), food("Peas, green, strained, canned, condensed, dried")
    assert ranked("peas", *foods, peas={"pear": 1, "pears": 1})[0].startswith("Peas")
    assert ranked("aple", food("Ales"), food("Apples"), aple={"apple": 1, "ale": 2}) == ["Apples", "Ales"]


def test_the_matching_label_is_told_and_label_keys_are_equal_for_labels_that_mean_the_same():
    (match,) = rank([query("courgette")], [food("Squash, summer, zucchini", "Courgettes")])
    assert match.label == "Courgettes"
    assert label_key("Potatoes, Baked") == label_key("baked potato")
    assert label_key("Pear") != label_key("Pears, dried")


def test_a_dish_of_fndds_takes_the_place_of_the_first_dish_but_not_of_what_is_none_or_matches_better():
    ours = food("Lasagna with meat sauce", "lasagna", is_mixed_dish=True, is_curated=True)
    fndds = food("Lasagna with meat and spinach, frozen", is_mixed_dish=True, is_fndds=True)
    assert ranked("lasagna", ours, fndds)[0] == fndds.labels[0]
    egg, creamed = food("Egg, boiled"), food("Egg, creamed", is_mixed_dish=True, is_fndds=True)
    assert ranked("egg", creamed, egg)[0] == "Egg, boiled"
    soup, stew = food("Soup, tomato", is_mixed_dish=True), food("Stew, tomato", is_mixed_dish=True, is_fndds=True)
    assert ranked("tomato soup", stew, soup) == ["Soup, tomato"]


def test_index_holds_forms_of_words_and_beginnings_of_heads_and_ranks_a_food_by_its_head_first():
    ranks = posting_ranks("Apples, raw", ["Golden one"], "Fruits", "raw")
    assert {"apples", "apple", "a*", "ap*", "raw", "golden", "g*", "go*", "one"} <= ranks.keys()
    assert "r*" not in ranks
    ranks = [posting_ranks(name, [], "", None)["apple"] for name in ("Apples, raw", "Apple juice", "Strudel, apple")]
    assert ranks == sorted(ranks)
    assert len(set(ranks)) == 3
