"""SQL that keeps the food search's index: the foods of each word, the words, their trigrams (models.py)."""

from collections.abc import Collection, Mapping, Sequence

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from app.db.bulk import insert_rows
from app.foods.models import Food
from app.foods.search.models import FoodPosting, FoodWord, FoodWordTrigram


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
