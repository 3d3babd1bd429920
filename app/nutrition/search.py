"""Finding a food by words, ranked as a person expects: "apple" gives the raw apple before anything made of apples.

Works on labels (name, aliases, key) so that it serves a table in memory and rows of a database alike.
"""

import re
import unicodedata
from collections.abc import Sequence

from app.nutrition.foods import Food, FoodTable

_Words = tuple[str, ...]


def search_foods(table: FoodTable, words: str) -> list[Food]:
    """The table's foods that match the words, best first (rank_labels)."""
    return [table.foods[position] for position in rank_labels([_labels(food) for food in table.foods], words)]


def find_food(table: FoodTable, label: str) -> Food | None:
    """The food that goes by exactly this name (find_label), or None."""
    position = find_label([_labels(food) for food in table.foods], label)
    return None if position is None else table.foods[position]


def rank_labels(labels: Sequence[Sequence[str]], words: str) -> list[int]:
    """Positions of the foods in which each word begins some word of one label, best first; none for no words.

    labels: each food's labels, the foods in the table's order. A label that is the query ranks before one that starts
    with it, that before the rest; then whole words before beginnings, shorter labels before longer, and last the
    table's order, which is by how common a food is.
    """
    query = _words(words)
    if not query:
        return []
    ranked = []
    for position, food_labels in enumerate(labels):
        ranks = [_rank(query, label) for label in map(_words, food_labels) if _matches(query, label)]
        if ranks:
            ranked.append((min(ranks), position))
    return [position for _, position in sorted(ranked)]


def find_label(labels: Sequence[Sequence[str]], label: str) -> int | None:
    """Position of the first food with this very label; case, accents, plural and the order of words aside."""
    wanted = sorted(_words(label))
    if not wanted:
        return None
    for position, food_labels in enumerate(labels):
        if any(sorted(_words(candidate)) == wanted for candidate in food_labels):
            return position
    return None


def _matches(query: _Words, label: _Words) -> bool:
    return all(any(word.startswith(wanted) for word in label) for wanted in query)


def _rank(query: _Words, label: _Words) -> tuple[bool, bool, int, int]:
    beginnings = sum(wanted not in label for wanted in query)
    return (sorted(label) != sorted(query), not label[0].startswith(query[0]), beginnings, len(label))


def _labels(food: Food) -> tuple[str, ...]:
    return (food.name, *food.aliases, food.key)


def _words(text: str) -> _Words:
    """Lower-case words without accents and plural endings, so that "Potatoes" meets "potato"."""
    plain = unicodedata.normalize("NFKD", text.casefold()).encode("ascii", "ignore").decode()
    return tuple(_singular(word) for word in re.findall(r"[a-z0-9]+", plain))


def _singular(word: str) -> str:
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    if word.endswith("oes") and len(word) > 4:
        return word[:-2]
    if word.endswith("s") and not word.endswith(("ss", "us")) and len(word) > 3:
        return word[:-1]
    return word
