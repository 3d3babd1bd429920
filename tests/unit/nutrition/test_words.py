import random
from functools import cache

import pytest

from app.nutrition.search import singular, split_words, trigrams, typo_distance, word_forms


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Apples, raw, with skin", ["apples", "raw", "with", "skin"]),
        ("A\u0308pfel", ["apfel"]),
        ("Straße", ["strasse"]),
        ("мёд", ["мед"]),
        ("苹果 apple 3.25%", ["苹", "果", "apple", "3", "25"]),
        ("がら", ["が", "ら"]),
        ("사과 주스", ["사과", "주스"]),
        ("सेब", ["सेब"]),
        ("\uff21\uff42", ["ab"]),
        ("100%_%", ["100"]),
        ("\x00 \U0001f34e ,;!", []),
    ],
)
def test_text_is_split_into_folded_words(text, words):
    assert split_words(text) == words


def test_long_words_count_by_their_beginning_singular_is_the_likeliest_form_and_trigrams_mark_the_ends():
    assert split_words("x" * 100) == ["x" * 64]
    assert (singular("berries"), singular("tomatoes"), singular("bread")) == ("berry", "tomato", "bread")
    assert trigrams("egg") == {"  e", " eg", "egg", "gg "}
    assert [typo_distance("noodel", "noodle", 2), typo_distance("zz", "apple", 2)] == [1, None]
    assert [typo_distance("avac", "avocado", 2, begun=True), typo_distance("avac", "avocado", 2)] == [1, None]


@pytest.mark.parametrize(
    ("plural", "one"),
    [
        ("potatoes", "potato"),
        ("strawberries", "strawberry"),
        ("leaves", "leaf"),
        ("olives", "olive"),
        ("swiss", "swiss"),
        ("gas", "gas"),
    ],
)
def test_forms_of_a_plural_hold_its_singular(plural, one):
    assert one in word_forms(plural)
    assert word_forms(plural)[0] == plural


def test_distance_equals_that_of_the_recursive_definition():
    @cache
    def slow(a, b):
        if not a or not b:
            return len(a) + len(b)
        best = min(slow(a[:-1], b) + 1, slow(a, b[:-1]) + 1, slow(a[:-1], b[:-1]) + (a[-1] != b[-1]))
        if len(a) > 1 and len(b) > 1 and a[-1] == b[-2] and a[-2] == b[-1]:
            best = min(best, slow(a[:-2], b[:-2]) + 1)
        return best

    random_words = random.Random(1)
    for _ in range(500):
        a, b = ("".join(random_words.choices("abc", k=random_words.randint(1, 6))) for _ in range(2))
        whole, begun = slow(a, b), min(slow(a, b[:end]) for end in range(len(b) + 1))
        assert typo_distance(a, b, 2) == (whole if whole <= 2 else None), (a, b)
        assert typo_distance(a, b, 2, begun=True) == (begun if begun <= 2 else None), (a, b)
