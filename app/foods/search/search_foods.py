"""Search the food tables in force: query text -> foods, best first (docs/foods.md).

Takes a few SQL statements whatever the size of the tables: count each word; find words similar to
mistyped ones; read the best few hundred foods by the index's rank, which nutrition/search.py then
ranks. For browsing each result comes with its energy and its density.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from sqlalchemy.orm import Session

from app.db.session import Database
from app.foods import queries as foods
from app.foods.food_values import bare_value, pooled_densities
from app.foods.models import Food, FoodRelease
from app.foods.queries import DENSITIES_ONLY, LOCAL, SAME_FOOD_SYSTEMS, releases_in_force
from app.foods.schemas import FoodGroupOut, FoodMatch
from app.foods.search import queries as index
from app.foods.search.queries import other_names
from app.nutrition.components import ENERGY_NUMBERS
from app.nutrition.density import resolve_density
from app.nutrition.foods import Density
from app.nutrition.search import (
    MAX_QUERY_WORDS,
    STARRED_LETTERS,
    Candidate,
    Query,
    QueryWord,
    Ranked,
    is_unspaced,
    may_be_begun,
    rank,
    split_words,
    trigrams,
    typo_distance,
    word_forms,
)

RANKED = 150  # foods that are ranked in full: the best by the index's rank
SCANNED = 600  # foods of the rarest word that are scanned first
SHADOWED = 25  # extra foods read, to replace those that local corrections shadow
SIMILAR = 60  # words that are compared letter by letter with a mistyped one
CORRECTIONS = 8  # most words that a mistyped one is corrected to
_CURATED = (LOCAL, "csv", "starter")
_CODE = re.compile(r"(?=.*[0-9])[0-9A-Za-z][0-9A-Za-z._-]{2,39}")
_KEY = re.compile(r"[a-z0-9]+(?:[:-][a-z0-9_.]+)+")
FOODS_AT_ONCE = 100  # foods per statement


def search_foods(
    database: Database, words: str | None = None, *, group: str | None = None, limit: int = 50
) -> list[FoodMatch]:
    """Return foods of the releases in force, best match first; without words, in the tables' order.

    group: exact name, ignoring case; an unknown one has no foods. Words without a letter or a digit
    match nothing.
    """
    with database.read() as session:
        releases = {release.id: release for release in _searched_releases(session)}
        scope = index.Scope(tuple(releases), _groups_named(session, tuple(releases), group))
        if not releases or scope.groups == ():
            return []
        if words is None or not words.strip():
            rows = index.foods_in_order(session, scope, limit + SHADOWED)
            matches: list[tuple[index.FoodRow, str | None]] = [(row, None) for row in rows]
        else:
            matches = list(_match_rows(session, words.strip(), scope, releases, max(RANKED, limit)))
        matches = _without_shadowed(session, matches[: limit + SHADOWED], scope)
    return [_match_row(row, releases, label) for row, label in matches[:limit]]


def food_groups(database: Database) -> list[FoodGroupOut]:
    """Return the groups of the foods in force, by name."""
    with database.read() as session:
        groups = index.groups_in_force(
            session, [release.id for release in _searched_releases(session)]
        )
    return [FoodGroupOut(name=name, foods=count) for name, count in groups]


def _without_shadowed(
    session: Session, matches: list[tuple[index.FoodRow, str | None]], scope: index.Scope
) -> list[tuple[index.FoodRow, str | None]]:
    """Drop foods whose key belongs to a food in a release of higher precedence, since the key resolves to that one."""
    release_of_key = index.releases_of_keys(session, {row.key for row, _ in matches}, scope)
    return [(row, label) for row, label in matches if release_of_key[row.key] == row.release_id]


def _searched_releases(session: Session) -> list[FoodRelease]:
    return [release for release in releases_in_force(session) if release.source != DENSITIES_ONLY]


def _groups_named(
    session: Session, release_ids: tuple[int, ...], group: str | None
) -> tuple[str, ...] | None:
    if group is None:
        return None
    folded = group.strip().casefold()
    return tuple(
        name for name, _ in index.groups_in_force(session, release_ids) if name.casefold() == folded
    )


def _match_rows(
    session: Session, text: str, scope: index.Scope, releases: dict[int, FoodRelease], most: int
) -> list[tuple[index.FoodRow, str]]:
    """Return rows with the labels that matched, best first, each food once."""
    typed = split_words(text)[:MAX_QUERY_WORDS]
    if not typed:
        return []
    key = text.casefold() if _KEY.fullmatch(text.casefold()) else None
    codes = index.foods_with_code(session, text) if _CODE.fullmatch(text) else []
    unique = list(dict.fromkeys(typed))
    counts = dict(
        zip(
            unique,
            index.count_postings(session, [_word_pattern(QueryWord(word, {})) for word in unique]),
            strict=True,
        )
    )
    matches: list[tuple[index.FoodRow, str]] = []
    for is_mistyped in (False, True):
        mistyped = {word for word, count in counts.items() if is_mistyped or count == 0}
        queries = _readings(session, typed, counts, mistyped)
        food_ids = set(codes)
        for query in queries:
            food_ids.update(_foods_with(session, query, scope, most))
        rows = index.foods_to_rank(session, food_ids, key, scope)
        matches = _ranked(queries, rows, releases, {text} if codes else set(), key)
        if matches:
            break
    return matches


def _readings(
    session: Session, typed: list[str], counts: dict[str, int], mistyped: set[str]
) -> list[Query]:
    """Return the possible readings: the words as typed, with corrections of mistyped ones; two joined; one split."""
    joins = [[*typed[:i], typed[i] + typed[i + 1], *typed[i + 2 :]] for i in range(len(typed) - 1)]
    splits = [
        [*typed[:i], word[:cut], word[cut:], *typed[i + 1 :]]
        for i, word in enumerate(typed)
        if not counts[word] and not word.isdigit()
        for cut in range(3, len(word) - 2)
    ]
    new_words = {word for words in (*joins, *splits) for word in words if word not in counts}
    indexed = index.indexed_words(session, new_words) if new_words else set()
    typos = {word: _words_like(session, word) for word in mistyped}
    readings = [
        typed,
        *(words for words in (*joins, *splits) if indexed.issuperset(set(words) - counts.keys())),
    ]
    return [
        Query(
            tuple(QueryWord(word, typos.get(word, {})) for word in words),
            joined=int(words is not typed),
        )
        for words in readings
    ]


def _words_like(session: Session, word: str) -> dict[str, int]:
    """Return the corrections of a mistyped word -> its distance in letters, plus one if the first letter differs."""
    most = 0 if len(word) < 3 or word.isdigit() or is_unspaced(word) else min(3, 1 + len(word) // 6)
    if not most:
        return {}
    similar = index.similar_words(session, trigrams(word), SIMILAR)
    for begun in (False, True):
        distances = {
            other: distance + (other[0] != word[0])
            for other in similar
            if other != word
            and (distance := typo_distance(word, other, most, begun=begun)) is not None
        }
        if distances:
            best = min(distances.values())
            closest = sorted(
                (distance, other) for other, distance in distances.items() if distance <= best + 1
            )
            return {other: max(1, distance) for distance, other in closest[:CORRECTIONS]}
    return {}


def _foods_with(session: Session, query: Query, scope: index.Scope, most: int) -> list[int]:
    """Return the ids of the `most` best foods that have all the words, by their rank for the rarest one."""
    words = [_word_pattern(word) for word in query.words]
    if len(words) == 1:
        return index.foods_with_words(session, words, scope, most)
    counts = index.count_postings(session, words)
    rarest_first = [words[i] for i in sorted(range(len(words)), key=counts.__getitem__)]
    # if many foods have all the words, enough of them are among the first
    if min(counts) > SCANNED:
        food_ids = index.foods_with_words(
            session, rarest_first, scope, most, scanned=max(SCANNED, most)
        )
        if len(food_ids) == most:
            return food_ids
    return index.foods_with_words(session, rarest_first, scope, most)


def _word_pattern(typed: QueryWord) -> index.WordPattern:
    begun = typed.word if may_be_begun(typed.word) else None
    return index.WordPattern(
        words=frozenset((*word_forms(typed.word), *typed.typos)),
        begun=begun,
        short=f"{begun}*" if begun is not None and len(begun) <= STARRED_LETTERS else None,
    )


def _ranked(
    queries: Sequence[Query],
    rows: list[index.FoodRow],
    releases: dict[int, FoodRelease],
    codes: set[str],
    key: str | None,
) -> list[tuple[index.FoodRow, str]]:
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
    return _merge_same_foods(rank(queries, candidates), rows, order)


def _merge_same_foods(
    ranked: list[Ranked], rows: list[index.FoodRow], order: dict[int, int]
) -> list[tuple[index.FoodRow, str]]:
    """Merge foods of several releases that share a code: keep the best rank and the release of highest precedence."""
    entries: list[list[index.FoodRow]] = []
    labels: list[str] = []
    entry_of: dict[tuple[str, str], int] = {}
    for match in ranked:
        row = rows[match.position]
        codes = [
            (system, str(code))
            for system, code in row.source_ids.items()
            if system in SAME_FOOD_SYSTEMS
        ]
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


def _match_row(
    row: index.FoodRow, releases: dict[int, FoodRelease], matched: str | None
) -> FoodMatch:
    release = releases[row.release_id].title
    values = asdict(row) | {"group": row.food_group, "release": release, "matched": matched}
    return FoodMatch.model_validate(values)


@dataclass(frozen=True, slots=True)
class ListedFood:
    """A matched food.

    energy_kcal: of 100 g edible portion; density: the chosen one. None: not known.
    """

    food: FoodMatch
    energy_kcal: float | None
    density: Density | None


def list_foods(
    database: Database, words: str | None = None, *, group: str | None = None, limit: int = 50
) -> list[ListedFood]:
    """Return the results of search_foods in their order, each with the energy and density that read_food returns."""
    matches = search_foods(database, words, group=group, limit=limit)
    keys = [food.key for food in matches]
    figures: dict[str, tuple[float | None, Density | None]] = {}
    with database.read() as session:
        for start in range(0, len(keys), FOODS_AT_ONCE):
            rows = list(foods.foods_by_key(session, keys[start : start + FOODS_AT_ONCE]).values())
            figures |= dict(_figures(session, rows))
    return [ListedFood(food, *figures.get(food.key, (None, None))) for food in matches]


def _figures(
    session: Session, rows: Sequence[Food]
) -> Iterator[tuple[str, tuple[float | None, Density | None]]]:
    densities = pooled_densities(session, rows)
    contents = foods.contents_of(session, [row.id for row in rows], ENERGY_NUMBERS)
    for row in rows:
        energy = next(
            (contents[row.id][number] for number in ENERGY_NUMBERS if number in contents[row.id]),
            None,
        )
        choice = resolve_density(replace(bare_value(row), densities=densities[row.id]))
        yield row.key, (energy, choice.chosen if choice is not None else None)
