"""Finding a food by words, ranked as a person expects: "apple" gives the raw apple before anything made of apples.

Query and labels of foods -> the foods in order, by a sum of costs that each say what speaks against a food; and the
ranks by which the index keeps a word's best foods side by side. Pure: the database finds candidates, this decides. What
costs what, and why: docs/foods.md.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from app.nutrition.packaged_rows import packaged_rows
from app.nutrition.words import is_unspaced, singular, split_words, word_forms

MAX_QUERY_WORDS = 10  # the rest of a query is not looked at
STARRED_LETTERS = 2  # beginnings up to so short are looked for at the beginning of labels only (posting_ranks)

# Costs, in tenths of an unasked word. They were set on half of the judged queries (tests/data/food_search/judged.csv).
OTHER_LABEL = 10  # the label is an alias
SHARED_LABEL = 40  # an alias of a published table: many foods share it ("hamburger", of ground beef)
TYPO, FURTHER_TYPO = 120, 60  # sought only where no food has the words as typed
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
UNASKED_OF_KIND = {"plain": 1, "common": 3, "part": 1, "unusual": 20, "processed": 30}  # descriptors.csv
LONE_PART = 40  # "chicken, skin" is no chicken; "with skin" is
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

# What a word that nobody asked for makes of a food: nothing else, the usual sort, a part, a variant, another food.
_KIND_OF_WORD = {row["word"]: row["kind"] for row in packaged_rows("descriptors.csv")}

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
        of_label = burden + label.cost // 2 + (OTHER_LABEL if number else 0)
        for place, (forms, segment) in enumerate(zip(label.forms, label.segments, strict=True)):
            is_head = segment == label.head
            cost = of_label + ((place and HEAD_BEGUN) if is_head else HEAD_MISSED + segment * FURTHER_SEGMENT)
            words = list(forms)
            if is_head and may_be_begun(forms[0]):
                words += [f"{forms[0][:letters]}*" for letters in range(1, STARRED_LETTERS + 1)]
            for word in words:
                ranks[word] = min(ranks.get(word, cost), cost)
    return {word: max(0, cost) for word, cost in ranks.items()}


def label_key(label: str) -> str:
    """A label without case, accents, plurals and the order of its words: equal for labels that mean the same."""
    return " ".join(sorted(singular(word) for word in split_words(label)))


@dataclass(frozen=True, slots=True)
class _Label:
    """A label taken apart: each word's forms, the number of its part between commas, its cost if nobody asked for it.

    places: form -> the first word that has it. text: the words, each with a blank before it. head: the segment that
    says what the food is, head_places its words. cost: of all the words.
    """

    forms: tuple[tuple[str, ...], ...]
    segments: tuple[int, ...]
    costs: tuple[int, ...]
    places: Mapping[str, int]
    text: str
    head: int
    head_places: frozenset[int]
    cost: int
    brand: int

    def unasked(self, asked: Collection[int]) -> int:
        """What the words cost that were not asked for."""
        return self.cost - sum([self.costs[place] for place in asked])


@lru_cache(maxsize=4096)
def _label(text: str) -> _Label:
    words: list[str] = []
    segments: list[int] = []
    costs: list[int] = []
    segment, brackets, last = 0, 0, 0
    for piece in _PIECE.findall(text):
        if piece in "(),;":
            brackets = max(0, brackets + (piece == "(") - (piece == ")"))
            segment += piece in ",;" and not brackets
            continue
        for word in split_words(piece):
            if word in _DETAILS_FOLLOW and words:
                segment += 1
            words.append(word)
            segments.append(segment)
            costs.append(UNASKED_IN_BRACKETS if brackets else _unasked(word, is_lone=segment != last))
            last = segment
    heads = segments.count(0)
    head = 1 if 1 in segments and tuple(map(singular, words[:heads])) in CLASSES else 0
    if head:
        costs[:heads] = [0] * heads
    forms = tuple(map(word_forms, words))
    places: dict[str, int] = {}
    for place, of_word in enumerate(forms):
        for form in of_word:
            places.setdefault(form, place)
    return _Label(
        forms,
        tuple(segments),
        tuple(costs),
        places,
        text=" " + " ".join(words),
        head=head,
        head_places=frozenset([place for place, segment in enumerate(segments) if segment == head]),
        cost=sum(costs),
        brand=0 if text.isupper() else min(len(_BRAND.findall(text)) * BRAND_WORD, MOST_BRAND),
    )


@lru_cache(maxsize=16384)
def _unasked(word: str, *, is_lone: bool) -> int:
    kind = "plain" if word.isdigit() else _KIND_OF_WORD.get(singular(word))
    if kind is None:
        return UNASKED
    return LONE_PART if kind == "part" and is_lone else UNASKED_OF_KIND[kind]


def _burden(name: str, group: str, state: str | None) -> int:
    """What speaks against a food whatever was asked for."""
    return _label(name).brand + _burden_of_group(group, state)


@lru_cache(maxsize=1024)
def _burden_of_group(group: str, state: str | None) -> int:
    cost = 0
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
                name = _label(food.labels[0])
                cost += name.unasked({found[1] for word in query.words if (found := _cheapest(word, name))})
            if best is None or cost < best.cost:
                best = Ranked(position, cost, text, names_it)
    return best


def _match(query: Query, label: _Label) -> tuple[int, bool, bool] | None:
    """Cost of the label, whether the query names what it is, whether it is all of it; None if a word is missing."""
    cost, order = 0, []
    for wanted in query.words:
        found = _cheapest(wanted, label)
        if found is None:
            return None
        cost += found[0]
        order.append(found[1])
    is_exact = cost == 0
    asked = set(order)
    head_missed = len(label.head_places - asked)
    if label.head and 0 in [label.segments[place] for place in asked]:
        head_missed = 0  # the class was asked for, so each of its foods is meant
    if head_missed == len(label.head_places):
        cost += HEAD_MISSED
    elif head_missed:
        cost += HEAD_BEGUN if min(label.head_places) in asked else HEAD_SHARED
        cost += HEAD_WORD_UNASKED * head_missed
    if label.head:
        cost += CLASS_BEFORE_HEAD
    cost += FURTHER_SEGMENT * sum([abs(label.segments[place] - label.head) for place in order])
    cost += label.unasked(asked)
    if order != sorted(order):
        cost += OTHER_ORDER
    return cost, not head_missed, len(asked) == len(label.forms) and is_exact


def _cheapest(wanted: QueryWord, label: _Label) -> tuple[int, int] | None:
    """(cost, place) of the label's word that the typed word is best taken for, the first of equals; None if of none."""
    word = wanted.word
    for form in word_forms(word):
        if form in label.places:
            return 0, label.places[form]
    found = []
    if wanted.typos:
        found += [
            (TYPO + (wrong - 1) * FURTHER_TYPO, label.places[other])
            for other, wrong in wanted.typos.items()
            if other in label.places
        ]
    if f" {word}" in label.text and may_be_begun(word):
        found += [
            (BEGUN + BEGUN_PER_LETTER * min(len(forms[0]) - len(word), 10), place)
            for place, forms in enumerate(label.forms)
            if forms[0].startswith(word)
        ]
    return min(found, default=None)


def may_be_begun(word: str) -> bool:
    """Whether a typed word may be the beginning of a longer one: figures, and words of one character, match whole."""
    return not word.isdigit() and not is_unspaced(word)


def _fndds_dishes_first(found: list[Ranked], candidates: Sequence[Candidate]) -> list[Ranked]:
    places = [i for i, match in enumerate(found) if match.names_it and candidates[match.position].is_mixed_dish]
    dishes = sorted((found[i] for i in places), key=lambda match: not candidates[match.position].is_fndds)
    for place, dish in zip(places, dishes, strict=True):
        found[place] = dish
    return found
