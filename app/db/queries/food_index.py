"""SQL that keeps the food search's index: the foods of each word, the words, their trigrams (models/food_search.py)."""

from collections.abc import Collection, Mapping, Sequence

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from app.db.models import FoodPosting, FoodWord, FoodWordTrigram


def add_postings(session: Session, ranks: Mapping[int, Mapping[str, int]]) -> None:
    """Food id -> word -> rank into the index."""
    rows = [
        {"word": word, "rank": rank, "food_id": food_id}
        for food_id, of_words in ranks.items()
        for word, rank in of_words.items()
    ]
    if rows:
        session.connection().execute(sa.insert(FoodPosting), rows)


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
