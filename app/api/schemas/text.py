"""Text and numbers that every database can hold.

No NUL or lone surrogate in text, no number beyond what a measurement can be.
"""

import math
from typing import Annotated

from pydantic import AfterValidator, Field

LARGEST = 1e9  # of any number that a phone tells; JSON in a database keeps larger ones otherwise than they came


def only_text(value: object) -> object:
    """For a time: RFC 3339 is text; a bare number would be read as seconds since 1970."""
    if not isinstance(value, str):
        raise ValueError("must be text, such as 2026-11-21T12:30:00+08:00")  # noqa: TRY004  # pydantic wants this one
    return value


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
JsonNumber = Annotated[float, Field(strict=True), AfterValidator(_finite)]  # where no form sends it: "1" is no number
