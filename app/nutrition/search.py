"""Finding a food by words, ranked as a person expects: "apple" gives the raw apple before anything made of apples.

Query and labels of foods -> the foods in order, by a sum of costs that each say what speaks against a food; and the
ranks by which the index keeps a word's best foods side by side. Pure: the database finds candidates, this decides. What
costs what, and why: docs/food-search.md.
"""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

from app.nutrition.words import is_unspaced, singular, split_words, word_forms

MAX_QUERY_WORDS = 10  # the rest of a query is not looked at
STARRED_LETTERS = 2  # beginnings up to so short are looked for at the beginning of labels only (posting_ranks)

# Costs, in tenths of an unasked word. They were set on half of the judged queries (tests/data/food_search/judged.csv).
OTHER_LABEL = 10  # the label is an alias
SHARED_LABEL = (
    40  # an alias of a published table: what many foods share ("hamburger": ground beef) says less than a name
)
TYPO, FURTHER_TYPO = 120, 60  # no food with a mistyped word goes before one that has the word as typed
JOINED = 30  # "icecream" for "ice cream"
BEGUN, BEGUN_PER_LETTER = 40, 2  # "app" for "apple"
HEAD_WORD_UNASKED = 50  # "apple juice", "applesauce" for "apple"
HEAD_BEGUN = 20
HEAD_SHARED = 60  # "strudel, apple" is no apple
HEAD_MISSED = 80
CLASS_BEFORE_HEAD = 15  # "beverages, coffee" after "coffee"
FURTHER_SEGMENT = 2
OTHER_ORDER = 3
UNASKED, UNASKED_IN_BRACKETS = 10, 1
UNASKED_OF_KIND = {"plain": 1, "common": 3, "unusual": 20, "processed": 30}  # descriptors.csv
BRAND_WORD, MOST_BRAND = 30, 60
UNEXPECTED_STATE = 25
SPECIAL_GROUP = 50
CURATED = -30  # a table kept by hand holds what people commonly eat
WHOLE_LABEL = -40

# First parts of USDA's names that say of what class the food is; its own name comes behind.
CLASSES = frozenset(
    tuple(name.split())
    for name in (
        "beverage", "alcoholic beverage", "fish", "crustacean", "mollusk", "cereal", "cereal ready to eat", "candy",
        "snack", "spice", "nut", "seed", "fast food", "game meat", "leavening agent", "sweetener", "frozen novelty",
        "shellfish", "school lunch",
    )
)  # fmt: skip

# What a word that nobody asked for adds to a food's name: nothing, the usual sort, a variant, another food made of it.
_KIND_OF_WORD = {
    row["word"]: row["kind"]
    for row in csv.DictReader(
        (resources.files("app.nutrition") / "descriptors.csv").read_text(encoding="utf-8").splitlines()
    )
}

_EATEN_RAW_GROUPS = ("fruit", "vegetable")
_EATEN_COOKED_GROUPS = re.compile(
    r"\b(beef|pork|poultry|lamb|veal|finfish|cereal grains|legume|meats?|egg)", re.IGNORECASE
)
_SPECIAL_GROUPS = re.compile(r"\b(baby foods?|infant|american indian)\b", re.IGNORECASE)

_PIECE = re.compile(r"[(),;]|[^(),;]+")
_DETAILS_FOLLOW = frozenset(("with", "without", "in", "made", "prepared"))  # "lasagna with meat sauce" is a lasagna
_BRAND = re.compile(r"\b[A-Z][A-Z'\u2019]{3,}\b")


@dataclass(frozen=True, slots=True)
class QueryWord:
    """A word as typed. typos: words of the index that may be meant instead -> how many letters are wrong."""

    word: str
    typos: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Query:
    """Words that a food must all have. joined: how many blanks were put in or left out to get them."""

    words: tuple[QueryWord, ...]
    joined: int = 0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food to be ranked. labels: its name first, then aliases and codes. is_curated: of a table kept by hand.

    is_fndds: a dish or food as eaten in a survey. order: breaks ties, the smallest first.
    """

    labels: tuple[str, ...]
    group: str
    state: str | None
    is_mixed_dish: bool
    is_curated: bool
    is_fndds: bool
    order: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Ranked:
    """A match: the candidate's position, what speaks against it, the label that matched, whether that is what it is."""

    position: int
    cost: int
    label: str
    names_it: bool


def rank(queries: Sequence[Query], candidates: Sequence[Candidate]) -> list[Ranked]:
    """The candidates that match one of the queries, best first.

    queries: ways to read what was typed. Where mixed dishes match by what they are, not by a part, those of FNDDS take
    the places of the first ones: a dish as eaten defaults to FNDDS once that is imported.
    """
    found = [match for i, food in enumerate(candidates) if (match := _best(queries, i, food)) is not None]
    found.sort(key=lambda match: (match.cost, candidates[match.position].order))
    return _fndds_dishes_first(found, candidates)


def posting_ranks(name: str, others: Iterable[str], group: str, state: str | None) -> dict[str, int]:
    """Word -> rank of a food for the index: the cost that the food has for that word alone, the lowest of its labels.

    Holds each form of each word, and of the words that a label begins with also their first letter and first two with a
    star behind: a beginning so short is looked for at the beginning of labels only.
    """
    ranks: dict[str, int] = {}
    burden = _burden(name, group, state)
    for number, text in enumerate((name, *others)):
        label = _label(text)
        unasked = sum(part.cost for part in label.parts) // 2
        for place, part in enumerate(label.parts):
            is_head = part.segment == label.head
            cost = burden + unasked + (OTHER_LABEL if number else 0)
            cost += (place and HEAD_BEGUN) if is_head else HEAD_MISSED + part.segment * FURTHER_SEGMENT
            words = list(part.forms)
            if is_head and not is_unspaced(part.forms[0]):
                words += [f"{part.forms[0][:letters]}*" for letters in range(1, STARRED_LETTERS + 1)]
            for word in words:
                ranks[word] = min(ranks.get(word, cost), cost)
    return {word: max(0, cost) for word, cost in ranks.items()}


def label_key(label: str) -> str:
    """A label without case, accents, plurals and the order of its words: equal for labels that mean the same."""
    return " ".join(sorted(singular(word) for word in split_words(label)))


@dataclass(frozen=True, slots=True)
class _Part:
    """A word of a label. segment: the how manieth part between commas it stands in. cost: if it was not asked for."""

    forms: tuple[str, ...]
    segment: int
    cost: int


@dataclass(frozen=True, slots=True)
class _Label:
    """A label taken apart. head: the segment that says what it is."""

    parts: tuple[_Part, ...]
    head: int
    brand: int


@lru_cache(maxsize=4096)
def _label(text: str) -> _Label:
    parts: list[_Part] = []
    segment, brackets = 0, 0
    for piece in _PIECE.findall(text):
        if piece in "(),;":
            brackets = max(0, brackets + (piece == "(") - (piece == ")"))
            segment += piece in ",;" and not brackets
            continue
        for word in split_words(piece):
            segment += word in _DETAILS_FOLLOW and bool(parts)
            parts.append(_Part(word_forms(word), segment, UNASKED_IN_BRACKETS if brackets else _unasked(word)))
    classes = tuple(singular(part.forms[0]) for part in parts if part.segment == 0)
    head = 1 if classes in CLASSES and any(part.segment == 1 for part in parts) else 0
    if head:
        parts = [_Part(part.forms, part.segment, 0 if part.segment == 0 else part.cost) for part in parts]
    brands = 0 if text.isupper() else len(_BRAND.findall(text))
    return _Label(tuple(parts), head, min(brands * BRAND_WORD, MOST_BRAND))


def _unasked(word: str) -> int:
    if word.isdigit():
        return UNASKED_OF_KIND["plain"]
    return UNASKED_OF_KIND[kind] if (kind := _KIND_OF_WORD.get(singular(word))) else UNASKED


def _burden(name: str, group: str, state: str | None) -> int:
    """What speaks against a food whatever was asked for."""
    cost = _label(name).brand
    if _SPECIAL_GROUPS.search(group):
        cost += SPECIAL_GROUP
    is_raw_food = group.lower().startswith(_EATEN_RAW_GROUPS)
    if state == "raw" and not is_raw_food and _EATEN_COOKED_GROUPS.search(group):
        cost += UNEXPECTED_STATE
    return cost


def _best(queries: Sequence[Query], position: int, food: Candidate) -> Ranked | None:
    best: Ranked | None = None
    burden = _burden(food.labels[0], food.group, food.state) + (CURATED if food.is_curated else 0)
    for query in queries:
        for number, text in enumerate(food.labels):
            match = _match(query, _label(text))
            if match is None:
                continue
            cost, names_it, is_whole = match
            cost += burden + query.joined * JOINED
            if is_whole and (food.is_curated or not number):
                cost += WHOLE_LABEL
            if number:  # an alias: the name's own words still tell how plain the food is
                cost += OTHER_LABEL if food.is_curated else SHARED_LABEL
                cost += sum(part.cost for part in _missed(query, _label(food.labels[0]).parts))
            if best is None or cost < best.cost:
                best = Ranked(position, cost, text, names_it)
    return best


def _match(query: Query, label: _Label) -> tuple[int, bool, bool] | None:
    """Cost of the label, whether the query names what it is, whether it is all of it; None if a word is missing."""
    cost, places = 0, []
    for wanted in query.words:
        found = _cheapest(wanted, label.parts)
        if found is None:
            return None
        cost += found[0]
        places.append(found[1])
    is_exact = cost == 0
    asked = set(places)
    head = [i for i, part in enumerate(label.parts) if part.segment == label.head]
    head_missed = [i for i in head if i not in asked]
    if len(head_missed) == len(head):
        cost += HEAD_MISSED
    elif head_missed:
        cost += HEAD_BEGUN if head[0] in asked else HEAD_SHARED
        cost += HEAD_WORD_UNASKED * len(head_missed)
    if label.head:
        cost += CLASS_BEFORE_HEAD
    cost += sum(FURTHER_SEGMENT * abs(label.parts[i].segment - label.head) for i in places)
    cost += sum(part.cost for i, part in enumerate(label.parts) if i not in asked)
    if places != sorted(places):
        cost += OTHER_ORDER
    return cost, not head_missed, len(asked) == len(label.parts) and is_exact


def _cheapest(wanted: QueryWord, parts: Sequence[_Part]) -> tuple[int, int] | None:
    """(cost, place) of the label's word that the typed word is best taken for, the first of equals; None if of none."""
    word, typos = wanted.word, wanted.typos
    forms, is_open = word_forms(word), may_be_begun(word)
    best: tuple[int, int] | None = None
    for place, part in enumerate(parts):
        if any(form in part.forms for form in forms):
            return 0, place
        if is_open and part.forms[0].startswith(word):
            cost = BEGUN + BEGUN_PER_LETTER * min(len(part.forms[0]) - len(word), 10)
        elif typos and (wrong := [typos[form] for form in part.forms if form in typos]):
            cost = TYPO + (min(wrong) - 1) * FURTHER_TYPO
        else:
            continue
        if best is None or cost < best[0]:
            best = cost, place
    return best


def may_be_begun(word: str) -> bool:
    """Whether a typed word may be the beginning of a longer one: figures, and words of one character, match whole."""
    return not word.isdigit() and not is_unspaced(word)


def _missed(query: Query, parts: Sequence[_Part]) -> list[_Part]:
    asked = {found[1] for wanted in query.words if (found := _cheapest(wanted, parts)) is not None}
    return [part for i, part in enumerate(parts) if i not in asked]


def _fndds_dishes_first(found: list[Ranked], candidates: Sequence[Candidate]) -> list[Ranked]:
    places = [i for i, match in enumerate(found) if match.names_it and candidates[match.position].is_mixed_dish]
    dishes = sorted((found[i] for i in places), key=lambda match: not candidates[match.position].is_fndds)
    for place, dish in zip(places, dishes, strict=True):
        found[place] = dish
    return found
