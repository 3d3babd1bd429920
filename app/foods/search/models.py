"""The index of the foods: their codes, words of names and aliases, their trigrams for typos, which foods have a word.

Made from the foods, no truth of its own; the same on SQLite and PostgreSQL, without an extension.
"""

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base

# A range of words that share a beginning must be contiguous: compare by code point on both databases.
Word = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
Trigram = sa.String(3).with_variant(sa.String(3, collation="C"), "postgresql")


class FoodCode(Base):
    """A food's id in a published table, such as (sr28_ndb, 09003): the same food of two releases meets by it.

    Of a table that has densities only, the folded name stands here too, as the system "label".
    """

    __tablename__ = "food_code"

    system: Mapped[str] = mapped_column(sa.String(32), primary_key=True)
    code: Mapped[str] = mapped_column(sa.String(300), primary_key=True, index=True)
    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"), primary_key=True, index=True)


class FoodWord(Base):
    """A word, or a form of one, that stands in a label of some food, folded (nutrition/words.py)."""

    __tablename__ = "food_word"

    word: Mapped[str] = mapped_column(Word, primary_key=True)


class FoodWordTrigram(Base):
    """Three letters in a row of a word, its ends marked."""

    __tablename__ = "food_word_trigram"

    trigram: Mapped[str] = mapped_column(Trigram, primary_key=True)
    word: Mapped[str] = mapped_column(Word, sa.ForeignKey("food_word.word"), primary_key=True)


class FoodPosting(Base):
    """A food has this word in a label. rank: how good an answer the food is to that word alone, the lowest best.

    The word "ba*" stands for all words that begin with ba, so that the best few foods of a short beginning are read in
    order (nutrition/search.py, posting_ranks). The key holds all that a search walks through, the food's release too:
    the best foods of a word lie side by side, and no other table is looked at.
    """

    __tablename__ = "food_posting"

    word: Mapped[str] = mapped_column(Word, primary_key=True)
    rank: Mapped[int] = mapped_column(primary_key=True)
    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"), primary_key=True)
    release_id: Mapped[int] = mapped_column(primary_key=True)

    __table_args__ = (sa.Index(None, "food_id", "word"), {"sqlite_with_rowid": False})
