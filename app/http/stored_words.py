"""Words from columns that the database does not check, as one of those that the API has."""

from collections.abc import Sequence
from typing import TypeVar

Word = TypeVar("Word", bound=str)


def stored_word(word: str | None, words: Sequence[Word]) -> Word | None:
    """Return the word as one of `words`, or None for one that this version does not know.

    A row that another version has written must not turn an answer into a server error.
    """
    return next((each for each in words if each == word), None)
