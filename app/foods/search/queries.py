"""SQL of the food search: how often words stand, words like a mistyped one, the foods that have all words, by rank."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session, aliased

from app.db.bulk import insert_rows
from app.foods.models import Food
from app.foods.search.models import FoodCode, FoodPosting, FoodWord, FoodWordTrigram

COUNTED = 2000  # postings: what has more is as good as all
_LAST = "\U0010ffff"  # behind every letter


@dataclass(frozen=True, slots=True)
class FoundRow:
    """What is needed of a food to rank it and to list it."""

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


_ROWS: sa.Select[Any] = sa.select(*(getattr(Food, column.name) for column in fields(FoundRow)))
# Statements are made once: to put one together takes longer than to run it.
_ROWS_BY_ID = _ROWS.where(Food.id.in_(sa.bindparam("ids", expanding=True)))
_PLACES = sa.select(Food.key, Food.release_id, Food.superseded_by_id).where(
    Food.key.in_(sa.bindparam("keys", expanding=True))
)
_WITH_CODE = sa.select(FoodCode.food_id).where(FoodCode.code == sa.bindparam("code"), FoodCode.system != "label")
_SIMILAR = (
    sa.select(FoodWordTrigram.word)
    .where(FoodWordTrigram.trigram.in_(sa.bindparam("trigrams", expanding=True)))
    .group_by(FoodWordTrigram.word)
    .order_by(sa.func.count().desc(), sa.func.length(FoodWordTrigram.word), FoodWordTrigram.word)
    .limit(sa.bindparam("limit"))
)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the word of a posting may be: one of `words`, or any that begins with `begun`.

    short: the starred word that holds the best foods of a beginning of a letter or two, to walk through in their place.
    """

    words: frozenset[str]
    begun: str | None
    short: str | None


@dataclass(frozen=True, slots=True)
class Scope:
    """Where foods are looked for: releases in force in their order, groups by exact name (None: all)."""

    release_ids: tuple[int, ...]
    groups: tuple[str, ...] | None

    def holds(self, row: FoundRow) -> bool:
        """Whether a food is in it. Told here, not in SQL: a planner without statistics would walk through all foods."""
        is_listed = self.groups is None or row.food_group in self.groups
        return is_listed and row.superseded_by_id is None and row.release_id in self.release_ids


def count_postings(session: Session, words: Sequence[Wanted]) -> list[int]:
    """How many postings each word has, COUNTED at most."""
    counts = [
        sa.select(sa.literal(position).label("position"), sa.func.count().label("n")).select_from(
            sa.select(FoodPosting.food_id).where(_walked(word)).limit(COUNTED).subquery()
        )
        for position, word in enumerate(words)
    ]
    rows = session.execute(sa.union_all(*counts).order_by("position")) if counts else ()
    return [count for _, count in rows]


def similar_words(session: Session, trigrams: Collection[str], limit: int) -> list[str]:
    """Words that have the most of these trigrams, shorter ones first among equals."""
    return list(session.scalars(_SIMILAR, {"trigrams": sorted(trigrams), "limit": limit}))


def foods_with_words(
    session: Session, words: Sequence[Wanted], scope: Scope, limit: int, *, walked: int | None = None
) -> list[int]:
    """Ids of the foods that have all the words, by their rank for the first of them, the best `limit`.

    words: the rarest first, since that one is walked through. walked: look only at that many foods of it, its best.
    """
    first, *others = words
    rank = sa.func.min(FoodPosting.rank).label("rank")
    of_first = (
        sa.select(FoodPosting.food_id, rank)
        .where(_walked(first), FoodPosting.release_id.in_(scope.release_ids))
        .group_by(FoodPosting.food_id)
    )
    if walked is not None:
        of_first = of_first.order_by(rank, FoodPosting.food_id).limit(walked)
    food = of_first.subquery()
    query = sa.select(food.c.food_id).order_by(food.c.rank, food.c.food_id).limit(limit)
    for other in others:
        posting = aliased(FoodPosting)
        query = query.where(sa.exists().where(posting.food_id == food.c.food_id, _has(_by_food(posting), other)))
    if scope.groups is not None:
        query = query.where(sa.exists().where(Food.id == food.c.food_id, Food.food_group.in_(scope.groups)))
    return list(session.scalars(query))


def foods_with_code(session: Session, code: str) -> list[int]:
    """Ids of the foods, in force or not, that a published table knows by this number."""
    return list(session.scalars(_WITH_CODE, {"code": code}))


def foods_to_rank(session: Session, food_ids: Collection[int], key: str | None, scope: Scope) -> list[FoundRow]:
    """Those of these foods that the scope holds, and the one with this key."""
    found = list(session.execute(_ROWS_BY_ID, {"ids": sorted(food_ids)})) if food_ids else []
    if key is not None:
        found += session.execute(_ROWS.where(Food.key == key, Food.id.not_in(food_ids)))
    rows = [FoundRow(*row) for row in found]
    return [row for row in rows if scope.holds(row)]


def places_of_keys(session: Session, keys: Collection[str], scope: Scope) -> dict[str, int]:
    """Key -> the release whose food goes by it, the first of those in force, whatever the group."""
    order = {release_id: position for position, release_id in enumerate(scope.release_ids)}
    holding = [
        (order[release_id], key)
        for key, release_id, superseded_by_id in session.execute(_PLACES, {"keys": sorted(keys)})
        if release_id in order and superseded_by_id is None
    ]
    return {key: scope.release_ids[position] for position, key in sorted(holding, reverse=True)}


def foods_in_order(session: Session, scope: Scope, limit: int) -> list[FoundRow]:
    """The first foods of the releases, in the tables' order."""
    found: list[FoundRow] = []
    for release_id in scope.release_ids:
        query = _ROWS.where(Food.release_id == release_id, Food.superseded_by_id.is_(None))
        if scope.groups is not None:
            query = query.where(Food.food_group.in_(scope.groups))
        if len(found) < limit:
            rows = session.execute(query.order_by(Food.id).limit(limit - len(found)))
            found += [FoundRow(*row) for row in rows]
    return found


def groups_in_force(session: Session, release_ids: Collection[int]) -> list[tuple[str, int]]:
    """Food group -> how many foods it has, by name."""
    query = (
        sa.select(Food.food_group, sa.func.count(Food.key.distinct()))
        .where(Food.release_id.in_(release_ids), Food.superseded_by_id.is_(None))
        .group_by(Food.food_group)
    )
    return sorted((group, count) for group, count in session.execute(query))


def _by_food(posting: type[FoodPosting]) -> sa.SQLColumnExpression[str]:
    """The word of a posting that is found by its food: else SQLite would walk through all foods of the word."""
    return posting.word.concat("")


def _walked(wanted: Wanted) -> sa.ColumnElement[bool]:
    if wanted.short is not None:
        return FoodPosting.word.in_(sorted({*wanted.words, wanted.short}))
    return _has(FoodPosting.word, wanted)


def _has(column: sa.SQLColumnExpression[str], wanted: Wanted) -> sa.ColumnElement[bool]:
    one_of = column.in_(sorted(wanted.words))
    if wanted.begun is None:
        return one_of
    begun = sa.and_(column >= wanted.begun, column < wanted.begun + _LAST)
    return begun if wanted.words <= {wanted.begun} else sa.or_(begun, one_of)


def add_postings(session: Session, ranks: Sequence[tuple[Food, Mapping[str, int]]]) -> None:
    """Foods, each with the rank that it has for each of its words, into the index."""
    rows = [
        {"word": word, "rank": rank, "food_id": food.id, "release_id": food.release_id}
        for food, of_words in ranks
        for word, rank in of_words.items()
    ]
    insert_rows(session, FoodPosting, rows)


def known_words(session: Session, words: Collection[str]) -> set[str]:
    """Those of the words that some label has."""
    return set(session.scalars(sa.select(FoodWord.word).where(FoodWord.word.in_(sorted(words)))))


def add_words(session: Session, trigrams: Sequence[tuple[str, Collection[str]]]) -> None:
    """Words with their trigrams; another import may add the same ones at once."""
    if not trigrams:
        return
    insert = sqlite.insert if session.get_bind().dialect.name == "sqlite" else postgresql.insert
    connection = session.connection()
    connection.execute(insert(FoodWord).on_conflict_do_nothing(), [{"word": word} for word, _ in trigrams])
    connection.execute(
        insert(FoodWordTrigram).on_conflict_do_nothing(),
        [{"trigram": trigram, "word": word} for word, of_word in trigrams for trigram in sorted(of_word)],
    )
