"""Validation errors as sentences for the person who filled in a form: pydantic's error type and message -> sentence.

The API's problem documents keep pydantic's own messages, for programs and their authors.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Final

from pydantic_core import ErrorDetails

A_DAY: Final = "Write a day as 2026-11-30."
A_MOMENT: Final = "Write a day and a time as 2026-11-30T12:30:00+01:00."
WHOLE: Final = "Write a whole number, such as 4."
A_NUMBER: Final = "Write a number, such as 4.6."

# by a schema's pattern; tests/unit/dashboard/test_refusals.py compares them with the forms' schemas
PATTERNS: Final[Mapping[str, str]] = {
    r"^[A-Za-z0-9][A-Za-z0-9_-]*$": "Letters A-Z, digits, - and _ only, beginning with a letter or digit; no blanks.",
    r"^[a-z0-9][a-z0-9._-]{0,63}$": (
        "Small letters a-z, digits, dot, _ and - only, beginning with a letter or digit; no blanks, 64 characters at "
        "most."
    ),
    r"^(?:(?:0\d|1[01]):[0-5]\d|12:00)$": "Write a time from 00:00 to 12:00, as 03:00.",
    r"^(?:[01]\d|2[0-3]):[0-5]\d$": "Write times from 00:00 to 23:59, as 12:30.",
}
_SENTENCES: Final[Mapping[str, str]] = {
    "missing": "This field is required.",
    "extra_forbidden": "This field is not allowed here.",
    "bool_parsing": "Write true or false.",
    "uuid_parsing": "This is not an id.",
    "uuid_type": "This is not an id.",
    "string_type": "Write text.",
    "int_type": WHOLE,
    "int_parsing": WHOLE,
    "int_parsing_size": WHOLE,
    "int_from_float": WHOLE,
    "float_type": A_NUMBER,
    "float_parsing": A_NUMBER,
    "finite_number": A_NUMBER,
    "union_tag_invalid": "There is no such choice.",
    "union_tag_not_found": "There is no such choice.",
}
# {} is the number that pydantic's message names first
_LIMITS: Final[Mapping[str, str]] = {
    "greater_than": "This must be more than {}.",
    "greater_than_equal": "This must be {} or more.",
    "less_than": "This must be less than {}.",
    "less_than_equal": "This must be {} or less.",
    "string_too_short": "Letters or digits are missing: {} at least.",
    "string_too_long": "This is too long: {} characters at most.",
    "too_short": "Choose {} at least.",
    "too_long": "Choose {} at most.",
}
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_CHOICE = re.compile(r"'([^']*)'")
_PLACES = frozenset({"query", "path", "body", "header"})


def sentence(kind: str, message: str) -> str:
    """Return what to enter instead. kind, message: pydantic's error type and message."""
    if kind in _SENTENCES:
        return _SENTENCES[kind]
    if kind in _LIMITS and (limit := _NUMBER.search(message)) is not None:
        if kind == "string_too_short" and limit[0] == "1":
            return "This must not be empty."
        return _LIMITS[kind].format(limit[0])
    if kind.startswith("date_"):
        return A_DAY
    if kind.startswith("datetime_"):
        return A_MOMENT
    if kind in ("literal_error", "enum"):
        choices = [choice.replace("_", " ") for choice in _CHOICE.findall(message)]
        return f"There is no such choice; choose: {', '.join(choices)}."
    if kind == "string_pattern_mismatch":
        matches = (text for pattern, text in PATTERNS.items() if f"'{pattern}'" in message)
        return next(matches, "It contains a character that is not allowed here.")
    own_message = message.removeprefix("Value error, ").rstrip(".")
    return f"{own_message[:1].upper()}{own_message[1:]}."


def sentences(errors: Sequence[ErrorDetails]) -> dict[str, str]:
    """Return field -> sentence for pydantic's errors; a sentence about a part of a field begins with its name."""
    wrong: dict[str, list[str]] = {}
    for error in errors:
        field, *inner = error["loc"] or ("",)
        parts = ", ".join(part.replace("_", " ") for part in inner if isinstance(part, str))
        text = sentence(error["type"], error["msg"])
        wrong.setdefault(str(field), []).append(f"{parts}: {text}" if parts else text)
    return {field: " ".join(dict.fromkeys(texts)) for field, texts in wrong.items()}


def sentence_of_request(errors: Sequence[Mapping[str, object]]) -> str | None:
    """Return the first of a problem document's `errors` as a sentence that names the parameter; None without errors.

    The API's "query.from" is "From" on a page.
    """
    if not errors:
        return None
    first = errors[0]
    parts = [
        part for part in str(first["at"]).split(".") if part not in _PLACES and not part.isdecimal()
    ]
    text = sentence(str(first["type"]), str(first["message"]))
    name = parts[0].replace("_", " ") if parts else ""
    return f"{name[:1].upper()}{name[1:]}: {text}" if name else text
