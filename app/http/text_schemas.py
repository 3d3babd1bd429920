"""Text and numbers that every database can hold.

No NUL or lone surrogate in text, no number beyond what a measurement can be.
"""

import math
import re
from collections.abc import Sequence
from datetime import date, datetime
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, Field
from pydantic_core import PydanticCustomError

WRITTEN_DAY, WRITTEN_INSTANT = (
    re.compile(r"\d{4}-\d{2}-\d{2}"),
    re.compile(r"\d{4}-\d{2}-\d{2}[Tt ]"),
)
Word = TypeVar("Word", bound=str)
# of any number that a phone tells; JSON in a database keeps larger ones otherwise than they came
LARGEST = 1e9


def _only_a_written_day(value: object) -> object:
    """A number, written as text or not, would be read as seconds since 1970."""
    if isinstance(value, date) or (isinstance(value, str) and WRITTEN_DAY.fullmatch(value)):
        return value
    raise PydanticCustomError("date_parsing", "must be a date, such as 2026-11-21")


def _only_a_written_instant(value: object) -> object:
    if isinstance(value, datetime) or (isinstance(value, str) and WRITTEN_INSTANT.match(value)):
        return value
    raise PydanticCustomError(
        "datetime_parsing", "must be date and time, such as 2026-11-21T12:30:00+08:00"
    )


def unless_named(schema: dict[str, Any]) -> None:
    """For a field of a change, which stays as it is unless it is named: its default in Python is none in JSON."""
    schema.pop("default", None)


def _storable(value: str) -> str:
    if "\0" in value:
        raise ValueError("must not contain the character NUL")
    if any("\ud800" <= character <= "\udfff" for character in value):
        raise ValueError("must not contain half of a character (a lone surrogate)")
    return value


def _finite(value: float) -> float:
    if not math.isfinite(value) or abs(value) > LARGEST:
        raise ValueError("must be a finite number of a sensible size")
    return value


Text = Annotated[str, AfterValidator(_storable)]
Number = Annotated[float, AfterValidator(_finite)]
# where no form sends it: "1" is no number
JsonNumber = Annotated[float, Field(strict=True), AfterValidator(_finite)]
LocalDay = Annotated[date, BeforeValidator(_only_a_written_day)]
Instant = Annotated[datetime, BeforeValidator(_only_a_written_instant)]
AwareInstant = Annotated[AwareDatetime, BeforeValidator(_only_a_written_instant)]


def stored_word(word: str | None, words: Sequence[Word]) -> Word | None:
    """Return a word of a column that the database does not check as one of `words`, or None for an unknown one.

    A row that another version has written must not turn an answer into a server error.
    """
    return next((each for each in words if each == word), None)
