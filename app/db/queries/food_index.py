"""SQL of the food search's index: words, their trigrams, and where each word stands (app/db/models/food_search.py)."""

from collections.abc import Iterable, Sequence

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from app.db.models import Food, FoodPosting, FoodWord, FoodWordTrigram
from app.nutrition.search import label_words, trigrams

MAX_WORD = 64  # letters; what is longer is indexed by its beginning


def index_foods(session: Session, rows: Sequence[Food]) -> None:
    """Add these foods' names, aliases and codes to the index."""
    labels = [(row.id, number, words) for row in rows for number, words in enumerate(_labels(row))]
    ids = _word_ids(session, {word for _, _, words in labels for word in words})
    postings = [
        {"word_id": ids[word], "food_id": food_id, "label": number, "place": place, "label_words": len(words)}
        for food_id, number, words in labels
        for place, word in enumerate(words)
    ]
    if postings:
        session.connection().execute(sa.insert(FoodPosting), postings)


def _labels(row: Food) -> Iterable[list[str]]:
    for label in (row.name, *row.aliases, *row.source_ids.values()):
        yield [word[:MAX_WORD] for word in label_words(str(label))]


def _word_ids(session: Session, words: set[str]) -> dict[str, int]:
    """Ids of the words; new ones are added with their trigrams. Another import may add the same ones at once."""
    known = _known(session, words)
    missing = sorted(words - known.keys())
    if missing:
        insert = sqlite.insert if session.get_bind().dialect.name == "sqlite" else postgresql.insert
        session.execute(insert(FoodWord).on_conflict_do_nothing(), [{"word": word} for word in missing])
        added = _known(session, set(missing))
        session.execute(
            insert(FoodWordTrigram).on_conflict_do_nothing(),
            [{"trigram": trigram, "word_id": added[word]} for word in missing for trigram in trigrams(word)],
        )
        known |= added
    return known


def _known(session: Session, words: set[str]) -> dict[str, int]:
    rows = session.execute(sa.select(FoodWord.word, FoodWord.id).where(FoodWord.word.in_(sorted(words))))
    return dict(rows.tuples())
