"""Rank foods for a text query as a person expects: "apple" gives the raw apple first.

Words are folded regardless of case, accents, plural and script, and compared for typos. Query and
labels of foods -> the foods in order of a sum of costs, each a reason against a food; and the ranks
by which the index keeps a word's best foods adjacent. Pure: the database finds candidates, this
module ranks them. The costs and their reasons are in docs/foods.md.
"""

import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from app.nutrition.components import packaged_rows

MAX_WORD_LETTERS = 64  # longer words are truncated

_ASCII_WORD = re.compile(r"[a-z0-9]+")
_APOSTROPHES = re.compile("['\u2019\u02bc`]")  # "McDonald's" is one word
# combining classes up to this (kana voicing, Indic virama) change the letter: they are no accents
_VOICED_AND_VIRAMA = 9
# ø ł đ æ œ ı
_WITHOUT_DECOMPOSITION = str.maketrans(
    {"\u00f8": "o", "\u0142": "l", "\u0111": "d", "\u00e6": "ae", "\u0153": "oe", "\u0131": "i"}
)
# Scripts written without blanks between words: Thai to Myanmar, Khmer, kana, Han. Each character is
# a word there.
_UNSPACED = re.compile(
    "[\u0e00-\u0eff\u1000-\u109f\u1780-\u17ff\u3040-\u30ff\u3400-\u4dbf\u4e00-\u9fff\uf900-\ufaff\U00020000-\U0003ffff]"
)
MAX_QUERY_WORDS = 10  # further words are ignored
# prefixes up to this length match only at the beginning of labels (posting_ranks)
STARRED_LETTERS = 2

# Costs, in tenths of an extra word. They were tuned on half of the judged queries
# (tests/data/food_search/judged.csv).
OTHER_LABEL = 10  # the label is an alias
# an alias of a published table: many foods share it ("hamburger", of ground beef)
SHARED_LABEL = 40
TYPO, FURTHER_TYPO = 120, 60  # considered only if no food has the words as typed
JOINED = 30  # "icecream" for "ice cream"
BEGUN, BEGUN_PER_LETTER = 40, 2  # "app" for "apple"
EXTRA_HEAD_WORD = 50  # "apple juice", "applesauce" for "apple"
HEAD_BEGUN = 20
HEAD_SHARED = 60  # "strudel, apple" is not an apple
HEAD_MISSED = 80
CLASS_BEFORE_HEAD = 15  # "beverages, coffee" after "coffee"
FURTHER_SEGMENT = 2
OTHER_ORDER = 3
EXTRA_WORD, EXTRA_IN_BRACKETS = 10, 1
# descriptors.csv
EXTRA_OF_KIND = {"plain": 1, "common": 3, "part": 1, "unusual": 20, "processed": 30}
LONE_PART = 40  # "chicken, skin" is not chicken; "with skin" is
BRAND_WORD, MOST_BRAND = 30, 60
UNEXPECTED_STATE = 25
SPECIAL_GROUP = 50
CURATED = -30  # a curated table has what people commonly eat
WHOLE_LABEL = -40

# First segments of USDA's names that state the class of the food; its own name follows.
CLASSES = frozenset(
    tuple(name.split())
    for name in (
        "beverage", "alcoholic beverage", "fish", "crustacean", "mollusk", "cereal", "cereal ready to eat", "candy",
        "snack", "spice", "nut", "seed", "fast food", "game meat", "leavening agent", "sweetener", "frozen novelty",
        "shellfish", "school lunch",
    )
)  # fmt: skip

# The effect of an extra word on a food: none, the usual sort, a part, a variant, another food.
_KIND_OF_WORD = {row["word"]: row["kind"] for row in packaged_rows("descriptors.csv")}

_EATEN_RAW_GROUPS = ("fruit", "vegetable")
_EATEN_COOKED_GROUPS = re.compile(
    r"\b(beef|pork|poultry|lamb|veal|finfish|cereal grains|legume|meats?|egg)", re.IGNORECASE
)
_SPECIAL_GROUPS = re.compile(r"\b(baby foods?|infant|american indian)\b", re.IGNORECASE)

_PIECE = re.compile(r"[(),;]|[^(),;]+")
# "lasagna with meat sauce" is a lasagna
_DETAILS_FOLLOW = frozenset(("with", "without", "in", "made", "prepared"))
_BRAND = re.compile(r"\b[A-Z][A-Z'\u2019]{3,}\b")


def split_words(text: str) -> list[str]:
    """Return the folded words of a text in order; [] for a text without letters or digits.

    Lower case, without accents ("Äpfel" gives "apfel"). In a script without blanks each character
    is a word, so that parts match; in all others letters stay together, as do digits.
    """
    folded = _APOSTROPHES.sub("", text.casefold())
    if folded.isascii():
        return [word[:MAX_WORD_LETTERS] for word in _ASCII_WORD.findall(folded)]
    decomposed = unicodedata.normalize("NFKD", folded).casefold().translate(_WITHOUT_DECOMPOSITION)
    plain = "".join(c for c in decomposed if unicodedata.combining(c) <= _VOICED_AND_VIRAMA)
    letters = "".join(
        c if unicodedata.category(c)[0] in "LNM" else " "
        for c in unicodedata.normalize("NFC", plain)
    )
    return [word[:MAX_WORD_LETTERS] for word in _UNSPACED.sub(r" \g<0> ", letters).split()]


def is_unspaced(word: str) -> bool:
    """Return whether the word is of a script in which each character is a word."""
    return _UNSPACED.match(word) is not None


@lru_cache(maxsize=16384)
def word_forms(word: str) -> tuple[str, ...]:
    """Return the word, then its possible singulars by English rules; a few are wrong, which does no harm."""
    if len(word) < 4 or not word.endswith("s") or word.endswith(("ss", "us", "is")):
        return (word,)
    if word.endswith("ies"):
        return (word, word[:-3] + "y", word[:-1])
    if word.endswith("ves"):
        return (word, word[:-1], word[:-3] + "f")
    if word.endswith(("oes", "shes", "ches", "xes", "zes", "sses")):
        return (word, word[:-2], word[:-1])
    return (word, word[:-1])


def singular(word: str) -> str:
    """Return the word's most likely singular; the word itself if it is not a plural."""
    return word_forms(word)[:2][-1]


def trigrams(word: str) -> set[str]:
    """Return the word's trigrams, its ends marked by blanks so that the beginning counts more."""
    marked = f"  {word} "
    return {marked[i : i + 3] for i in range(len(marked) - 2)}


def typo_distance(typed: str, word: str, most: int, *, begun: bool = False) -> int | None:
    """Return the edit distance (deletions, insertions, changes, swaps of neighbours); None if more than `most`.

    begun: `typed` may be a prefix of the word. (Optimal string alignment.)
    """
    if len(typed) - len(word) > most or (not begun and len(word) - len(typed) > most):
        return None
    before: list[int] = []
    last = list(range(len(word) + 1))
    for i, letter in enumerate(typed, 1):
        row = [i]
        for j, other in enumerate(word, 1):
            cost = min(last[j] + 1, row[j - 1] + 1, last[j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == word[j - 2] and typed[i - 2] == other:
                cost = min(cost, before[j - 2] + 1)
            row.append(cost)
        if min(row) > most:
            return None
        before, last = last, row
    distance = min(last) if begun else last[-1]
    return distance if distance <= most else None


@dataclass(frozen=True, slots=True)
class QueryWord:
    """A word as typed.

    typos: words of the index that may be meant instead -> number of wrong letters.
    """

    word: str
    typos: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Query:
    """Words that a food must all have. joined: number of blanks inserted or removed to get them."""

    words: tuple[QueryWord, ...]
    joined: int = 0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A food to be ranked.

    labels: its name first, then aliases and codes. is_curated: from a curated table.

    is_fndds: from FNDDS, a survey's foods as eaten. order: breaks ties, the smallest first.
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
    """A match: the candidate's position, its cost, the label that matched, whether the query names the food itself."""

    position: int
    cost: int
    label: str
    names_it: bool


def rank(queries: Sequence[Query], candidates: Sequence[Candidate]) -> list[Ranked]:
    """Return the candidates that match one of the queries, best first.

    queries: readings of what was typed. Among mixed dishes that the query names as a whole, those
    of FNDDS come first: a dish as eaten defaults to FNDDS once that is imported.
    """
    matches = [
        match for i, food in enumerate(candidates) if (match := _best(queries, i, food)) is not None
    ]
    matches.sort(key=lambda match: (match.cost, candidates[match.position].order))
    return _fndds_dishes_first(matches, candidates)


def posting_ranks(
    name: str, other_names: Iterable[str], group: str, state: str | None
) -> dict[str, int]:
    """Return word -> rank of a food for the index: its cost for that word alone, the lowest of its labels.

    Contains each form of each word and, for words at the beginning of a label, their first letter
    and first two letters followed by a star, since such short prefixes match only at the beginning
    of labels.
    """
    ranks: dict[str, int] = {}
    burden = _burden(name, group, state)
    for number, text in enumerate((name, *other_names)):
        label = _label(text)
        label_cost = burden + label.cost // 2 + (OTHER_LABEL if number else 0)
        for place, (forms, segment) in enumerate(zip(label.forms, label.segments, strict=True)):
            is_head = segment == label.head
            cost = label_cost + (
                (place and HEAD_BEGUN) if is_head else HEAD_MISSED + segment * FURTHER_SEGMENT
            )
            words = list(forms)
            if is_head and may_be_begun(forms[0]):
                words += [f"{forms[0][:letters]}*" for letters in range(1, STARRED_LETTERS + 1)]
            for word in words:
                ranks[word] = min(ranks.get(word, cost), cost)
    return {word: max(0, cost) for word, cost in ranks.items()}


def label_key(label: str) -> str:
    """Return a label without case, accents, plurals and word order, so that labels of the same meaning are equal."""
    return " ".join(sorted(singular(word) for word in split_words(label)))


@dataclass(frozen=True, slots=True)
class _Label:
    """A parsed label: each word's forms, the segment between commas that it is in, and its cost as an extra word.

    places: form -> the first word that has it. text: the words, each preceded by a blank. head: the
    segment that names the food; head_places: its words. cost: of all the words.
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

    def extra_cost(self, matched: Collection[int]) -> int:
        """Return the cost of the words that the query does not match.

        matched: places of those that it matches.
        """
        return self.cost - sum([self.costs[place] for place in matched])


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
            costs.append(
                EXTRA_IN_BRACKETS if brackets else _extra_word_cost(word, is_lone=segment != last)
            )
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
def _extra_word_cost(word: str, *, is_lone: bool) -> int:
    kind = "plain" if word.isdigit() else _KIND_OF_WORD.get(singular(word))
    if kind is None:
        return EXTRA_WORD
    return LONE_PART if kind == "part" and is_lone else EXTRA_OF_KIND[kind]


def _burden(name: str, group: str, state: str | None) -> int:
    """Return the cost of a food that does not depend on the query."""
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
            if number:  # an alias: the words of the name still count
                cost += OTHER_LABEL if food.is_curated else SHARED_LABEL
                name = _label(food.labels[0])
                cost += name.extra_cost(
                    {word_match[1] for word in query.words if (word_match := _cheapest(word, name))}
                )
            if best is None or cost < best.cost:
                best = Ranked(position, cost, text, names_it)
    return best


def _match(query: Query, label: _Label) -> tuple[int, bool, bool] | None:
    """Return (cost, whether the query names the food, whether it is the whole label); None if a word is missing."""
    cost, order = 0, []
    for word in query.words:
        word_match = _cheapest(word, label)
        if word_match is None:
            return None
        cost += word_match[0]
        order.append(word_match[1])
    is_exact = cost == 0
    matched = set(order)
    head_missed = len(label.head_places - matched)
    if label.head and 0 in [label.segments[place] for place in matched]:
        head_missed = 0  # the query names the class, so each of its foods is meant
    if head_missed == len(label.head_places):
        cost += HEAD_MISSED
    elif head_missed:
        cost += HEAD_BEGUN if min(label.head_places) in matched else HEAD_SHARED
        cost += EXTRA_HEAD_WORD * head_missed
    if label.head:
        cost += CLASS_BEFORE_HEAD
    cost += FURTHER_SEGMENT * sum([abs(label.segments[place] - label.head) for place in order])
    cost += label.extra_cost(matched)
    if order != sorted(order):
        cost += OTHER_ORDER
    return cost, not head_missed, len(matched) == len(label.forms) and is_exact


def _cheapest(typed: QueryWord, label: _Label) -> tuple[int, int] | None:
    """Return (cost, place) of the label's word that best matches the typed word, the first of equals, or None."""
    word = typed.word
    for form in word_forms(word):
        if form in label.places:
            return 0, label.places[form]
    matches = []
    if typed.typos:
        matches += [
            (TYPO + (letters - 1) * FURTHER_TYPO, label.places[other])
            for other, letters in typed.typos.items()
            if other in label.places
        ]
    if f" {word}" in label.text and may_be_begun(word):
        matches += [
            (BEGUN + BEGUN_PER_LETTER * min(len(forms[0]) - len(word), 10), place)
            for place, forms in enumerate(label.forms)
            if forms[0].startswith(word)
        ]
    return min(matches, default=None)


def may_be_begun(word: str) -> bool:
    """Return whether a typed word may be a prefix of a longer one; digits and unspaced scripts match only whole."""
    return not word.isdigit() and not is_unspaced(word)


def _fndds_dishes_first(matches: list[Ranked], candidates: Sequence[Candidate]) -> list[Ranked]:
    places = [
        i
        for i, match in enumerate(matches)
        if match.names_it and candidates[match.position].is_mixed_dish
    ]
    dishes = sorted(
        (matches[i] for i in places), key=lambda match: not candidates[match.position].is_fndds
    )
    for place, dish in zip(places, dishes, strict=True):
        matches[place] = dish
    return matches
