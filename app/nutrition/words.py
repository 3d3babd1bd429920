"""Fold the words of labels and queries regardless of case, accents, plural and script, and compare them for typos.

Text -> words; a word -> its forms, its trigrams, its distance from another. Independent of foods.
"""

import re
import unicodedata
from functools import lru_cache

MAX_WORD_LETTERS = 64  # longer words are truncated

_ASCII_WORD = re.compile(r"[a-z0-9]+")
_APOSTROPHES = re.compile("['\u2019\u02bc`]")  # "McDonald's" is one word
# combining classes up to this (kana voicing, Indic virama) change the letter: they are no accents
_VOICED_AND_VIRAMA = 9
_WITHOUT_DECOMPOSITION = str.maketrans(
    {"\u00f8": "o", "\u0142": "l", "\u0111": "d", "\u00e6": "ae", "\u0153": "oe", "\u0131": "i"}
)  # ø ł đ æ œ ı
# Scripts written without blanks between words: Thai to Myanmar, Khmer, kana, Han. Each character is a word there.
_UNSPACED = re.compile(
    "[\u0e00-\u0eff\u1000-\u109f\u1780-\u17ff\u3040-\u30ff\u3400-\u4dbf\u4e00-\u9fff\uf900-\ufaff\U00020000-\U0003ffff]"
)


def split_words(text: str) -> list[str]:
    """Return the folded words of a text in order; [] for a text without letters or digits.

    Lower case, without accents ("Äpfel" gives "apfel"). In a script without blanks each character is a word, so that
    parts match; in all others letters stay together, as do digits.
    """
    folded = _APOSTROPHES.sub("", text.casefold())
    if folded.isascii():
        return [word[:MAX_WORD_LETTERS] for word in _ASCII_WORD.findall(folded)]
    decomposed = unicodedata.normalize("NFKD", folded).casefold().translate(_WITHOUT_DECOMPOSITION)
    plain = "".join(c for c in decomposed if unicodedata.combining(c) <= _VOICED_AND_VIRAMA)
    letters = "".join(
        c if unicodedata.category(c)[0] in "LNM" else " "
        for c in unicodedata.normalize("NFC", plain)
    )
    return [word[:MAX_WORD_LETTERS] for word in _UNSPACED.sub(r" \g<0> ", letters).split()]


def is_unspaced(word: str) -> bool:
    """Return whether the word is of a script in which each character is a word."""
    return _UNSPACED.match(word) is not None


@lru_cache(maxsize=16384)
def word_forms(word: str) -> tuple[str, ...]:
    """Return the word, then its possible singulars by English rules; a few are wrong, which does no harm."""
    if len(word) < 4 or not word.endswith("s") or word.endswith(("ss", "us", "is")):
        return (word,)
    if word.endswith("ies"):
        return (word, word[:-3] + "y", word[:-1])
    if word.endswith("ves"):
        return (word, word[:-1], word[:-3] + "f")
    if word.endswith(("oes", "shes", "ches", "xes", "zes", "sses")):
        return (word, word[:-2], word[:-1])
    return (word, word[:-1])


def singular(word: str) -> str:
    """Return the word's most likely singular; the word itself if it is not a plural."""
    return word_forms(word)[:2][-1]


def trigrams(word: str) -> set[str]:
    """Return the word's trigrams, its ends marked by blanks so that the beginning counts more."""
    marked = f"  {word} "
    return {marked[i : i + 3] for i in range(len(marked) - 2)}


def typo_distance(typed: str, word: str, most: int, *, begun: bool = False) -> int | None:
    """Return the edit distance (deletions, insertions, changes, swaps of neighbours); None if more than `most`.

    begun: `typed` may be a prefix of the word. (Optimal string alignment.)
    """
    if len(typed) - len(word) > most or (not begun and len(word) - len(typed) > most):
        return None
    before: list[int] = []
    last = list(range(len(word) + 1))
    for i, letter in enumerate(typed, 1):
        row = [i]
        for j, other in enumerate(word, 1):
            cost = min(last[j] + 1, row[j - 1] + 1, last[j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == word[j - 2] and typed[i - 2] == other:
                cost = min(cost, before[j - 2] + 1)
            row.append(cost)
        if min(row) > most:
            return None
        before, last = last, row
    distance = min(last) if begun else last[-1]
    return distance if distance <= most else None
