"""The index of the foods: their codes, words of names and aliases, their trigrams for typos, where each word stands.

Made from the foods, no truth of its own; the same on SQLite and PostgreSQL, without an extension.
"""

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.models.base import Base

# A range of words that share a beginning must be contiguous: compare by code point on both databases.
Word = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
Trigram = sa.String(3).with_variant(sa.String(3, collation="C"), "postgresql")


class FoodCode(Base):
    """A food's id in a published table, such as (sr28_ndb, 09003): the same food of two releases meets by it.

    Of a table that has densities only, the folded name stands here too, as the system "label".
    """

    __tablename__ = "food_code"

    system: Mapped[str] = mapped_column(sa.String(32), primary_key=True)
    code: Mapped[str] = mapped_column(sa.String(300), primary_key=True)
    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"), primary_key=True, index=True)


class FoodWord(Base):
    """A word that stands in a label of some food, folded (nutrition/search.py)."""

    __tablename__ = "food_word"

    id: Mapped[int] = mapped_column(primary_key=True)
    word: Mapped[str] = mapped_column(Word, unique=True)


class FoodWordTrigram(Base):
    """Three letters in a row of a word, its ends marked."""

    __tablename__ = "food_word_trigram"

    trigram: Mapped[str] = mapped_column(Trigram, primary_key=True)
    word_id: Mapped[int] = mapped_column(sa.ForeignKey("food_word.id"), primary_key=True)


class FoodPosting(Base):
    """Where a word stands: in which label of a food (0: its name), at which place of how many words."""

    __tablename__ = "food_posting"

    word_id: Mapped[int] = mapped_column(sa.ForeignKey("food_word.id"), primary_key=True)
    food_id: Mapped[int] = mapped_column(sa.ForeignKey("food.id"), primary_key=True, index=True)
    label: Mapped[int] = mapped_column(primary_key=True)
    place: Mapped[int] = mapped_column(primary_key=True)
    label_words: Mapped[int]
