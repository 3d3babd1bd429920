"""Tables of the food index: codes, words of names and aliases, trigrams of words for typos, postings of words.

Derived from the foods; the same on SQLite and PostgreSQL, without an extension.
"""

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.db.base import Base
from app.db.columns import FoodRef, IntKey, Str32, Str300

# Words with the same beginning must be a contiguous range: compare by code point on both databases.
Word = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
Trigram = sa.String(3).with_variant(sa.String(3, collation="C"), "postgresql")


class FoodCode(Base):
    """A food's id in a published table, such as (sr28_ndb, 09003); joins the same food of two releases.

    Foods of a table that has only densities also have their folded name here, under the system
    "label".
    """

    __tablename__ = "food_code"

    system: Mapped[Str32] = mapped_column(primary_key=True)
    code: Mapped[Str300] = mapped_column(primary_key=True, index=True)
    food_id: Mapped[FoodRef] = mapped_column(primary_key=True, index=True)


class FoodWord(Base):
    """A folded word, or a form of one, in a label of some food (nutrition/search.py)."""

    __tablename__ = "food_word"

    word: Mapped[str] = mapped_column(Word, primary_key=True)


class FoodWordTrigram(Base):
    """Three consecutive letters of a word, its ends marked."""

    __tablename__ = "food_word_trigram"

    trigram: Mapped[str] = mapped_column(Trigram, primary_key=True)
    word: Mapped[str] = mapped_column(Word, sa.ForeignKey("food_word.word"), primary_key=True)


class FoodPosting(Base):
    """A food has this word in a label.

    rank: how well the food answers a search for that word alone; lowest is best.

    The word "ba*" represents all words that begin with ba, so that the best foods for a short
    prefix are read in order (nutrition/search.py, posting_ranks). The key covers everything that a
    search scans, the food's release too: a word's best foods are adjacent, and no other table is
    read.
    """

    __tablename__ = "food_posting"

    word: Mapped[str] = mapped_column(Word, primary_key=True)
    rank: Mapped[IntKey]
    food_id: Mapped[FoodRef] = mapped_column(primary_key=True)
    release_id: Mapped[IntKey]

    __table_args__ = (sa.Index(None, "food_id", "word"), {"sqlite_with_rowid": False})
