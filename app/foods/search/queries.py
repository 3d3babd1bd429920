"""The index of the food search: its SQL, and adding foods to it.

A food is found by its words, which have ranks; a mistyped word by its trigrams.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session, aliased

from app.db.bulk import insert_rows
from app.foods.models import Food
from app.foods.search.models import FoodCode, FoodPosting, FoodWord, FoodWordTrigram
from app.nutrition.search import posting_ranks, trigrams

COUNTED = 2000  # postings; counting stops here
_LAST = "\U0010ffff"  # behind every letter
_KINDS = frozenset({"fdc_data_type", "sr28_figures"})  # source ids that name a food's data set


@dataclass(frozen=True, slots=True)
class FoodRow:
    """The columns of a food that ranking and listing need."""

    id: int
    release_id: int
    key: str
    name: str
    aliases: list[str]
    food_group: str
    form: str
    state: str | None
    is_mixed_dish: bool
    source_ids: dict[str, str]
    superseded_by_id: int | None


_ROWS: sa.Select[Any] = sa.select(*(getattr(Food, column.name) for column in fields(FoodRow)))
# Statements are built once: building one takes longer than running it.
_ROWS_BY_ID = _ROWS.where(Food.id.in_(sa.bindparam("ids", expanding=True)))
_PLACES = sa.select(Food.key, Food.release_id, Food.superseded_by_id).where(
    Food.key.in_(sa.bindparam("keys", expanding=True))
)
_WITH_CODE = sa.select(FoodCode.food_id).where(
    FoodCode.code == sa.bindparam("code"), FoodCode.system != "label"
)
_SIMILAR = (
    sa.select(FoodWordTrigram.word)
    .where(FoodWordTrigram.trigram.in_(sa.bindparam("trigrams", expanding=True)))
    .group_by(FoodWordTrigram.word)
    .order_by(sa.func.count().desc(), sa.func.length(FoodWordTrigram.word), FoodWordTrigram.word)
    .limit(sa.bindparam("limit"))
)


@dataclass(frozen=True, slots=True)
class WordPattern:
    """The words of postings to match: one of `words`, or any that begins with `begun`.

    short: the starred word with the best foods for a prefix of one or two letters, scanned in place
    of all its words.
    """

    words: frozenset[str]
    begun: str | None
    short: str | None


@dataclass(frozen=True, slots=True)
class Scope:
    """What a search covers: releases in force in their order, groups by exact name (None: all)."""

    release_ids: tuple[int, ...]
    groups: tuple[str, ...] | None

    def holds(self, row: FoodRow) -> bool:
        """Return whether a food is in scope.

        Not in SQL: a planner without statistics would scan all foods.
        """
        is_listed = self.groups is None or row.food_group in self.groups
        return is_listed and row.superseded_by_id is None and row.release_id in self.release_ids


def count_postings(session: Session, words: Sequence[WordPattern]) -> list[int]:
    """Return how many postings each word has, COUNTED at most."""
    counts = [
        sa.select(sa.literal(position).label("position"), sa.func.count().label("n")).select_from(
            sa.select(FoodPosting.food_id).where(_is_scanned(word)).limit(COUNTED).subquery()
        )
        for position, word in enumerate(words)
    ]
    rows = session.execute(sa.union_all(*counts).order_by("position")) if counts else ()
    return [count for _, count in rows]


def similar_words(session: Session, trigrams: Collection[str], limit: int) -> list[str]:
    """Return the words that share the most of these trigrams, shorter ones first among equals."""
    return list(session.scalars(_SIMILAR, {"trigrams": sorted(trigrams), "limit": limit}))


def foods_with_words(
    session: Session,
    words: Sequence[WordPattern],
    scope: Scope,
    limit: int,
    *,
    scanned: int | None = None,
) -> list[int]:
    """Return the ids of the best `limit` foods that have all the words, by their rank for the first word.

    words: the rarest first, since its postings are scanned. scanned: scan only that many of its
    best foods.
    """
    first, *other_words = words
    rank = sa.func.min(FoodPosting.rank).label("rank")
    first_matches = (
        sa.select(FoodPosting.food_id, rank)
        .where(_is_scanned(first), FoodPosting.release_id.in_(scope.release_ids))
        .group_by(FoodPosting.food_id)
    )
    if scanned is not None:
        first_matches = first_matches.order_by(rank, FoodPosting.food_id).limit(scanned)
    food = first_matches.subquery()
    query = sa.select(food.c.food_id).order_by(food.c.rank, food.c.food_id).limit(limit)
    for other in other_words:
        posting = aliased(FoodPosting)
        query = query.where(
            sa.exists().where(posting.food_id == food.c.food_id, _has(_by_food(posting), other))
        )
    if scope.groups is not None:
        query = query.where(
            sa.exists().where(Food.id == food.c.food_id, Food.food_group.in_(scope.groups))
        )
    return list(session.scalars(query))


def foods_with_code(session: Session, code: str) -> list[int]:
    """Return the ids of the foods, in force or not, with this number in a published table."""
    return list(session.scalars(_WITH_CODE, {"code": code}))


def foods_to_rank(
    session: Session, food_ids: Collection[int], key: str | None, scope: Scope
) -> list[FoodRow]:
    """Return those of these foods that are in scope, and the one with this key."""
    selected = list(session.execute(_ROWS_BY_ID, {"ids": sorted(food_ids)})) if food_ids else []
    if key is not None:
        selected += session.execute(_ROWS.where(Food.key == key, Food.id.not_in(food_ids)))
    rows = [FoodRow(*row) for row in selected]
    return [row for row in rows if scope.holds(row)]


def releases_of_keys(session: Session, keys: Collection[str], scope: Scope) -> dict[str, int]:
    """Return key -> id of the first release in force that has a food of this key, in any group."""
    order = {release_id: position for position, release_id in enumerate(scope.release_ids)}
    holding = [
        (order[release_id], key)
        for key, release_id, superseded_by_id in session.execute(_PLACES, {"keys": sorted(keys)})
        if release_id in order and superseded_by_id is None
    ]
    return {key: scope.release_ids[position] for position, key in sorted(holding, reverse=True)}


def foods_in_order(session: Session, scope: Scope, limit: int) -> list[FoodRow]:
    """Return the first foods of the releases, in the tables' order."""
    foods: list[FoodRow] = []
    for release_id in scope.release_ids:
        query = _ROWS.where(Food.release_id == release_id, Food.superseded_by_id.is_(None))
        if scope.groups is not None:
            query = query.where(Food.food_group.in_(scope.groups))
        if len(foods) < limit:
            rows = session.execute(query.order_by(Food.id).limit(limit - len(foods)))
            foods += [FoodRow(*row) for row in rows]
    return foods


def groups_in_force(session: Session, release_ids: Collection[int]) -> list[tuple[str, int]]:
    """Return (food group, number of foods), by name."""
    query = (
        sa.select(Food.food_group, sa.func.count(Food.key.distinct()))
        .where(Food.release_id.in_(release_ids), Food.superseded_by_id.is_(None))
        .group_by(Food.food_group)
    )
    return sorted((group, count) for group, count in session.execute(query))


def _by_food(posting: type[FoodPosting]) -> sa.SQLColumnExpression[str]:
    """Return the word column in a form that keeps SQLite from scanning all foods of the word: it looks up by food."""
    return posting.word.concat("")


def _is_scanned(wanted: WordPattern) -> sa.ColumnElement[bool]:
    if wanted.short is not None:
        return FoodPosting.word.in_(sorted({*wanted.words, wanted.short}))
    return _has(FoodPosting.word, wanted)


def _has(column: sa.SQLColumnExpression[str], pattern: WordPattern) -> sa.ColumnElement[bool]:
    is_listed = column.in_(sorted(pattern.words))
    if pattern.begun is None:
        return is_listed
    is_begun = sa.and_(column >= pattern.begun, column < pattern.begun + _LAST)
    return is_begun if pattern.words <= {pattern.begun} else sa.or_(is_begun, is_listed)


def add_postings(session: Session, ranks: Sequence[tuple[Food, Mapping[str, int]]]) -> None:
    """Insert foods into the index, each with its rank per word."""
    rows = [
        {"word": word, "rank": rank, "food_id": food.id, "release_id": food.release_id}
        for food, by_word in ranks
        for word, rank in by_word.items()
    ]
    insert_rows(session, FoodPosting, rows)


def indexed_words(session: Session, words: Collection[str]) -> set[str]:
    """Return those of the words that are in the index."""
    return set(session.scalars(sa.select(FoodWord.word).where(FoodWord.word.in_(sorted(words)))))


def add_words(session: Session, trigrams: Sequence[tuple[str, Collection[str]]]) -> None:
    """Insert words with their trigrams; another import may insert the same ones concurrently."""
    if not trigrams:
        return
    insert = sqlite.insert if session.get_bind().dialect.name == "sqlite" else postgresql.insert
    connection = session.connection()
    connection.execute(
        insert(FoodWord).on_conflict_do_nothing(), [{"word": word} for word, _ in trigrams]
    )
    connection.execute(
        insert(FoodWordTrigram).on_conflict_do_nothing(),
        [
            {"trigram": trigram, "word": word}
            for word, word_trigrams in trigrams
            for trigram in sorted(word_trigrams)
        ],
    )


def index_foods(session: Session, rows: Sequence[Food]) -> None:
    """Add these foods' names and aliases to the index; the rows must have ids."""
    ranks = [
        (
            row,
            posting_ranks(
                row.name, other_names(row.aliases, row.source_ids), row.food_group, row.state
            ),
        )
        for row in rows
    ]
    new_words = {
        word
        for _, by_word in ranks
        for word in by_word
        if not word.endswith("*") and not word.isdigit()
    }
    missing = sorted(new_words - indexed_words(session, new_words))
    add_words(session, [(word, trigrams(word)) for word in missing])
    add_postings(session, ranks)


def other_names(aliases: Sequence[str], source_ids: Mapping[str, object]) -> Iterator[str]:
    """Yield a food's labels beside its name: aliases, and names in sources, which are stored with the source ids."""
    yield from aliases
    for system, name in source_ids.items():
        if is_name(system):
            yield str(name)


def is_name(system: str) -> bool:
    """Return whether the source id of this system is a display name, not a code."""
    return system.endswith("_name")


def is_code(system: str) -> bool:
    """Return whether the source id of this system is a code of this food, not a name or a data set."""
    return not is_name(system) and system not in _KINDS
