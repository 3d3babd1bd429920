"""Search the food tables in force: what was typed -> foods, best first (docs/foods.md).

A few SQL statements whatever the size of the tables: how often each word stands; words like the mistyped ones; the best
few hundred foods by the index's rank; those ranked by nutrition/search.py.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.db.session import Database
from app.foods.models import FoodRelease
from app.foods.queries import DENSITIES_ONLY, LOCAL, SAME_FOOD_SYSTEMS, releases_in_force
from app.foods.search import queries as index
from app.foods.search.index_foods import other_names
from app.nutrition.search import (
    MAX_QUERY_WORDS,
    STARRED_LETTERS,
    Candidate,
    Query,
    QueryWord,
    Ranked,
    may_be_begun,
    rank,
)
from app.nutrition.words import is_unspaced, split_words, trigrams, typo_distance, word_forms

RANKED = 150  # foods that are ranked in full: the best by the index's rank
WALKED = 600  # foods of the rarest word that are looked at first
SHADOWED = 25  # foods more than asked for, in place of those that local corrections stand before
SIMILAR = 60  # words that are compared letter by letter with a mistyped one
MEANT = 8  # words that a mistyped one may stand for
_CURATED = (LOCAL, "csv", "starter")
_CODE = re.compile(r"(?=.*[0-9])[0-9A-Za-z][0-9A-Za-z._-]{2,39}")
_KEY = re.compile(r"[a-z0-9]+(?:[:-][a-z0-9_.]+)+")


@dataclass(frozen=True, slots=True)
class FoundFood:
    """A food in a list. release: name and version. matched: the label that has the words; None without words."""

    key: str
    name: str
    aliases: Sequence[str]
    group: str
    form: str
    state: str | None
    is_mixed_dish: bool
    release: str
    matched: str | None


@dataclass(frozen=True, slots=True)
class FoodGroup:
    """A food group in force and how many foods it has."""

    name: str
    foods: int


def search_foods(
    database: Database, words: str | None = None, *, group: str | None = None, limit: int = 50
) -> list[FoundFood]:
    """Foods of the releases in force, best match first; without words, in the tables' order.

    group: its exact name, case aside; an unknown one has no foods. Words without a letter or a figure find nothing.
    """
    with database.read() as session:
        releases = {release.id: release for release in _searched(session)}
        scope = index.Scope(tuple(releases), _groups_called(session, tuple(releases), group))
        if not releases or scope.groups == ():
            return []
        if words is None or not words.strip():
            rows = index.foods_in_order(session, scope, limit + SHADOWED)
            found: list[tuple[index.FoundRow, str | None]] = [(row, None) for row in rows]
        else:
            found = list(_find(session, words.strip(), scope, releases, max(RANKED, limit)))
        found = _without_shadowed(session, found[: limit + SHADOWED], scope)
    return [_found(row, releases, label) for row, label in found[:limit]]


def food_groups(database: Database) -> list[FoodGroup]:
    """The groups of the foods in force, by name."""
    with database.read() as session:
        found = index.groups_in_force(session, [release.id for release in _searched(session)])
    return [FoodGroup(name, count) for name, count in found]


def _without_shadowed(
    session: Session, found: list[tuple[index.FoundRow, str | None]], scope: index.Scope
) -> list[tuple[index.FoundRow, str | None]]:
    """Without foods in whose place a release that goes first has another: whoever asks for the key gets that one."""
    places = index.places_of_keys(session, {row.key for row, _ in found}, scope)
    return [(row, label) for row, label in found if places[row.key] == row.release_id]


def _searched(session: Session) -> list[FoodRelease]:
    return [release for release in releases_in_force(session) if release.source != DENSITIES_ONLY]


def _groups_called(session: Session, release_ids: tuple[int, ...], group: str | None) -> tuple[str, ...] | None:
    if group is None:
        return None
    wanted = group.strip().casefold()
    return tuple(name for name, _ in index.groups_in_force(session, release_ids) if name.casefold() == wanted)


def _find(
    session: Session, text: str, scope: index.Scope, releases: dict[int, FoodRelease], most: int
) -> list[tuple[index.FoundRow, str]]:
    """Rows with the labels that matched, best first, each food once."""
    typed = split_words(text)[:MAX_QUERY_WORDS]
    if not typed:
        return []
    key = text.casefold() if _KEY.fullmatch(text.casefold()) else None
    codes = index.foods_with_code(session, text) if _CODE.fullmatch(text) else []
    unique = list(dict.fromkeys(typed))
    counts = dict(
        zip(unique, index.count_postings(session, [_wanted(QueryWord(word, {})) for word in unique]), strict=True)
    )
    found: list[tuple[index.FoundRow, str]] = []
    for is_mistyped in (False, True):
        mistyped = {word for word, count in counts.items() if is_mistyped or count == 0}
        queries = _readings(session, typed, counts, mistyped)
        food_ids = set(codes)
        for query in queries:
            food_ids.update(_foods_with(session, query, scope, most))
        rows = index.foods_to_rank(session, food_ids, key, scope)
        found = _ranked(queries, rows, releases, {text} if codes else set(), key)
        if found:
            break
    return found


def _readings(session: Session, typed: list[str], counts: dict[str, int], mistyped: set[str]) -> list[Query]:
    """What may have been meant: the words as typed, mistyped ones with those like them; two joined; one split."""
    joins = [[*typed[:i], typed[i] + typed[i + 1], *typed[i + 2 :]] for i in range(len(typed) - 1)]
    splits = [
        [*typed[:i], word[:cut], word[cut:], *typed[i + 1 :]]
        for i, word in enumerate(typed)
        if not counts[word] and not word.isdigit()
        for cut in range(3, len(word) - 2)
    ]
    made = {word for words in (*joins, *splits) for word in words if word not in counts}
    known = index.known_words(session, made) if made else set()
    typos = {word: _words_like(session, word) for word in mistyped}
    readings = [typed, *(words for words in (*joins, *splits) if known.issuperset(set(words) - counts.keys()))]
    return [
        Query(tuple(QueryWord(word, typos.get(word, {})) for word in words), joined=int(words is not typed))
        for words in readings
    ]


def _words_like(session: Session, word: str) -> dict[str, int]:
    """Words of the index that the mistyped one may stand for -> how wrong it is: letters, and one for the first."""
    most = 0 if len(word) < 3 or word.isdigit() or is_unspaced(word) else min(3, 1 + len(word) // 6)
    if not most:
        return {}
    similar = index.similar_words(session, trigrams(word), SIMILAR)
    for begun in (False, True):
        wrong = {
            other: distance + (other[0] != word[0])
            for other in similar
            if other != word and (distance := typo_distance(word, other, most, begun=begun)) is not None
        }
        if wrong:
            best = min(wrong.values())
            near = sorted((distance, other) for other, distance in wrong.items() if distance <= best + 1)
            return {other: max(1, distance) for distance, other in near[:MEANT]}
    return {}


def _foods_with(session: Session, query: Query, scope: index.Scope, most: int) -> list[int]:
    """Ids of the foods that have all the words, the best `most` by their rank for the rarest one."""
    words = [_wanted(word) for word in query.words]
    if len(words) == 1:
        return index.foods_with_words(session, words, scope, most)
    counts = index.count_postings(session, words)
    rarest_first = [words[i] for i in sorted(range(len(words)), key=counts.__getitem__)]
    if min(counts) > WALKED:  # where many foods have all the words, enough of them are among the first
        found = index.foods_with_words(session, rarest_first, scope, most, walked=max(WALKED, most))
        if len(found) == most:
            return found
    return index.foods_with_words(session, rarest_first, scope, most)


def _wanted(typed: QueryWord) -> index.Wanted:
    begun = typed.word if may_be_begun(typed.word) else None
    return index.Wanted(
        words=frozenset((*word_forms(typed.word), *typed.typos)),
        begun=begun,
        short=f"{begun}*" if begun is not None and len(begun) <= STARRED_LETTERS else None,
    )


def _ranked(
    queries: Sequence[Query],
    rows: list[index.FoundRow],
    releases: dict[int, FoodRelease],
    codes: set[str],
    key: str | None,
) -> list[tuple[index.FoundRow, str]]:
    order = {release_id: position for position, release_id in enumerate(releases)}
    candidates = [
        Candidate(
            labels=(
                row.name,
                *other_names(row.aliases, row.source_ids),
                *(codes & set(row.source_ids.values())),
                *({row.key} & {key}),
            ),
            group=row.food_group,
            state=row.state,
            is_mixed_dish=row.is_mixed_dish,
            is_curated=releases[row.release_id].source in _CURATED,
            is_fndds=releases[row.release_id].source == "fdc" and "fndds" in row.source_ids,
            order=(order[row.release_id], row.id),
        )
        for row in rows
    ]
    return _each_once(rank(queries, candidates), rows, order)


def _each_once(
    ranked: list[Ranked], rows: list[index.FoundRow], order: dict[int, int]
) -> list[tuple[index.FoundRow, str]]:
    """Of foods of several releases that share a code, the one whose release goes first, at the best one's place."""
    entries: list[list[index.FoundRow]] = []
    labels: list[str] = []
    entry_of: dict[tuple[str, str], int] = {}
    for match in ranked:
        row = rows[match.position]
        codes = [(system, str(code)) for system, code in row.source_ids.items() if system in SAME_FOOD_SYSTEMS]
        same = [entry_of[code] for code in codes if code in entry_of]
        if same and row.release_id not in {twin.release_id for twin in entries[same[0]]}:
            entry = same[0]
            entries[entry].append(row)
        else:
            entry = len(entries)
            entries.append([row])
            labels.append(match.label)
        for code in codes:
            entry_of.setdefault(code, entry)
    best = (min(twins, key=lambda twin: order[twin.release_id]) for twins in entries)
    return list(zip(best, labels, strict=True))


def _found(row: index.FoundRow, releases: dict[int, FoodRelease], matched: str | None) -> FoundFood:
    return FoundFood(
        key=row.key,
        name=row.name,
        aliases=row.aliases,
        group=row.food_group,
        form=row.form,
        state=row.state,
        is_mixed_dish=row.is_mixed_dish,
        release=releases[row.release_id].title,
        matched=matched,
    )
